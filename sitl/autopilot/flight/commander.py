"""Arming, modes and failsafes: the commander decides what may be flown, not how.

Everything that differs between autopilots comes from the tables of the `AutopilotProfile`.
"""

from collections import deque
from math import inf

from sitl.autopilot.flight.modes import CommandResult, Failsafe, Mode, Severity, Task, VehicleStatus
from sitl.autopilot.flight.profile import AutopilotProfile

Text = tuple[Severity, str]
_ENDS_WITH_FLIGHT = (Task.LAND, Task.PRECISION_LAND, Task.RETURN, Task.TAKE_OFF)


class Commander:
    """Arming state, mode, the task within it, and the texts for the ground (`texts`).

    `subtask` is what a mission has flown at present, None for plain flying. `disarmings` counts how often the
    motors were stopped, for callers that poll too slowly to see each.
    """

    def __init__(self, profile: AutopilotProfile) -> None:
        self._profile = profile
        self.situation = VehicleStatus()
        self.armed = False
        self.disarmings = 0
        self.in_failsafe = False
        self.stays_armed = False  # a fault: no failsafe disarms
        self.texts: deque[Text] = deque((Severity.INFO, text) for text in profile.texts.boot)
        self.mode = profile.mode(profile.boot_mode)
        self.task = self.mode.task
        self.subtask: Task | None = None
        self._left_mode: Mode | None = None
        self._left_by: Failsafe | None = None
        self._held_s = [0.0] * len(profile.failsafes)

    # ------------------------------------------------------------ commands

    def arm(self, force: bool) -> CommandResult:
        """Start the motors if every check passes; force skips the checks."""
        if self.armed:
            return CommandResult.ACCEPTED
        self._refresh()
        refusal = next((c.text for c in self._profile.arming_checks if not c.passes(self.situation)), None)
        if refusal is not None and not force:
            self.send_text(Severity.CRITICAL, refusal)
            return self._profile.refused
        self.armed = True
        self.situation.has_flown = False
        self.send_text(Severity.INFO, self._profile.texts.armed)
        return CommandResult.ACCEPTED

    def disarm(self, force: bool) -> CommandResult:
        """Stop the motors: on the ground, or anywhere by force."""
        if not self.armed:
            return CommandResult.ACCEPTED
        if not self.situation.landed and not force:
            self.send_text(Severity.CRITICAL, self._profile.refused_disarming_text)
            return self._profile.refused
        self._stop(Severity.INFO, self._profile.texts.disarmed)
        return CommandResult.ACCEPTED

    def change_mode(self, mode: Mode | None, number: int = 0) -> CommandResult:
        """Enter a mode with its own task; None is a number the autopilot does not know."""
        if mode is None:
            self.send_text(Severity.WARNING, self._profile.texts.no_such_mode.format(number=number))
            return self._profile.refused
        self._refresh()
        refusal = next((c.text for c in self._profile.mode_checks if c.fails(mode, self.situation)), None)
        if refusal is not None:
            self.send_text(Severity.CRITICAL, refusal.format(mode=mode.display_name))
            return self._profile.refused
        self._forget_failsafe()
        self._enter(mode)
        if mode.task is Task.LAND and self.armed:
            self.send_text(Severity.INFO, self._profile.texts.landing)
        return CommandResult.ACCEPTED

    def begin(self, task: Task) -> None:
        """Another task within the present mode."""
        self.task, self.subtask = task, None

    def recover(self) -> None:
        """After a reset in flight: nothing is left of failsafes and modes, it holds."""
        self._forget_failsafe()
        self._enter(self._profile.mode(self._profile.hold_mode))

    @property
    def flown(self) -> Task:
        """The present task, that of the mission item where there is one."""
        return self.task if self.subtask is None else self.subtask

    @property
    def intended_mode(self) -> Mode:
        """The mode that was chosen last; a failsafe that waits for its cause to end flies another."""
        return self.mode if self._left_mode is None else self._left_mode

    def terminate(self) -> None:
        """Stop the motors, also in the air."""
        if self.armed:
            self._stop(Severity.CRITICAL, self._profile.texts.terminated or self._profile.texts.disarmed)

    def send_text(self, severity: Severity, text: str) -> None:
        """Queue a text for the ground; an empty one is not sent."""
        if text:
            self.texts.append((severity, text))

    # ------------------------------------------------------------ every outer step

    def update(self, dt_s: float) -> None:
        """Check the failsafes against the caller's updated `situation`."""
        self._refresh()
        if not self.armed:
            return
        if self._left_mode is not None and self._left_by is not None:
            self.situation.streaming = self._left_mode.task is Task.SETPOINT
            if not self._left_by.condition(self.situation):
                mode = self._left_mode
                self._forget_failsafe()
                self._enter(mode)
                return
        for index, failsafe in enumerate(self._profile.failsafes):
            # one mode is left at a time, but what a failsafe has landed is disarmed as ever
            if self._left_by is not None and failsafe.mode:
                continue
            if not failsafe.condition(self.situation):
                if failsafe.over is None or failsafe.over(self.situation) or self._held_s[index] > -inf:
                    self._held_s[index] = 0.0
                continue
            if self.stays_armed and not failsafe.mode:
                continue
            self._held_s[index] += dt_s
            if self._held_s[index] >= failsafe.after_s:
                if failsafe.over is not None:
                    self._held_s[index] = -inf
                self._respond(failsafe)
                return

    def _refresh(self) -> None:
        now = self.situation
        now.task, now.armable, now.armed = self.flown, self.mode.armable, self.armed
        now.streaming = self.mode.task is Task.SETPOINT

    def _respond(self, failsafe: Failsafe) -> None:
        if not failsafe.mode:
            self._stop(failsafe.severity, failsafe.text)
            return
        self.send_text(failsafe.severity, failsafe.text)
        if failsafe.over is None:
            self._left_mode, self._left_by = self.mode, failsafe
        self.in_failsafe = True
        self._enter(self._profile.mode(failsafe.mode))
        if failsafe.task is not None:
            self.begin(failsafe.task)

    def _enter(self, mode: Mode) -> None:
        # entering the mode one is in already does not interrupt what is flown there
        if mode is not self.mode:
            self.mode = mode
            self.begin(mode.task)

    def _stop(self, severity: Severity, text: str) -> None:
        self.armed = False
        self.disarmings += 1
        self.send_text(severity, text)
        self._forget_failsafe()
        self._held_s = [0.0] * len(self._held_s)
        if self._profile.after_disarm_mode and self.mode.task in _ENDS_WITH_FLIGHT:
            self._enter(self._profile.mode(self._profile.after_disarm_mode))
        self.begin(self.mode.task)

    def _forget_failsafe(self) -> None:
        self._left_mode, self._left_by, self.in_failsafe = None, None, False
