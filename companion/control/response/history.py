"""The latest commands, and the vehicle's predicted state when the next command arrives.

A command that is sent at t reaches the autopilot's loop at t + delay. To predict the vehicle's state when
the next one arrives, the commands that are still on their way are applied to the model first. NED, SI
units.
"""

from collections import deque
from dataclasses import dataclass

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, add, scale, subtract
from companion.base.motion import Motion
from companion.control.response.flight_model import advance

REMEMBERED = 64  # two seconds of commands at 30 Hz


@dataclass(frozen=True, slots=True)
class SentCommand:
    """An acceleration (m/s2) that was sent at `sent_s`, and the velocity (m/s) that went with it, if any.

    `gains_1_s` are those of the autopilot's loops that follow this velocity; 0 on an axis that has none.
    With a `thrust` (NED, share of full thrust) that is what was sent, and makes the acceleration.
    """

    sent_s: float
    acceleration_m_s2: Vector3
    velocity_m_s: Vector3 | None = None
    gains_1_s: Vector3 = ZERO3
    thrust: Vector3 | None = None


class CommandHistory:
    """The last commands, and the acceleration that the autopilot's velocity loop makes of them.

    `commands` has the newest last; `full_thrust_m_s2` is what full thrust is believed to be worth.
    """

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self.full_thrust_m_s2 = 0.0
        self.commands: deque[SentCommand] = deque(maxlen=REMEMBERED)

    def last_effect(self, velocity_m_s: Vector3) -> Vector3 | None:
        """What the newest command makes the autopilot want at this velocity; None when there is none."""
        return self.effect(self.commands[-1], velocity_m_s) if self.commands else None

    def effect(self, command: SentCommand, velocity_m_s: Vector3) -> Vector3:
        """Acceleration (m/s2) that the autopilot wants under a command at a velocity."""
        if command.thrust is not None:
            return add(scale(command.thrust, self.full_thrust_m_s2), (0.0, 0.0, GRAVITY_M_S2))
        if command.velocity_m_s is None:
            return command.acceleration_m_s2
        (x, y, z), (kx, ky, kz) = subtract(command.velocity_m_s, velocity_m_s), command.gains_1_s
        return add(command.acceleration_m_s2, (kx * x, ky * y, kz * z))

    def segments(self, from_s: float, to_s: float) -> list[tuple[float, SentCommand | None]]:
        """Pieces (duration, command in effect) of the time between; None before the first takes effect."""
        pieces: list[tuple[float, SentCommand | None]] = []
        ends_s = to_s
        for command in reversed(self.commands):  # the newest alone matter
            if ends_s <= from_s:
                break
            begins_s = max(from_s, command.sent_s + self._delay_s)
            if begins_s < ends_s:
                pieces.append((ends_s - begins_s, command))
                ends_s = begins_s
        if ends_s > from_s:
            pieces.append((ends_s - from_s, None))
        return pieces[::-1]

    def carry(
        self, motion: Motion, from_s: float, to_s: float, disturbance_m_s2: Vector3, lags_s: Vector3
    ) -> Motion:
        """The motion at `to_s` from that at `from_s`, under what was commanded and a constant disturbance."""
        for duration_s, command in self.segments(from_s, to_s):
            wanted = motion.acceleration_m_s2
            if command is not None:
                halfway = add(motion.velocity_m_s, scale(motion.acceleration_m_s2, 0.5 * duration_s))
                wanted = add(self.effect(command, halfway), disturbance_m_s2)
            motion = advance(motion, wanted, duration_s, lags_s)
        return motion
