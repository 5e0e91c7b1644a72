"""The mission's state: where it is, who has the vehicle, how many tries it has used. The table moves it."""

from __future__ import annotations

from companion.base.messages import Phase
from companion.plan.mission.states import Authority, Branch, Circumstances, Effect, MissionEvent, State
from companion.plan.mission.table import follows


class StateMachine:
    """Asks the table what follows, and takes it."""

    def __init__(self, retries: int) -> None:
        self._retries = retries
        self._tries = 0
        self.state = State.CONNECT
        self.authority = Authority.NONE

    @property
    def phase(self) -> Phase:
        """The phase of the present state."""
        return self.state.phase

    @property
    def in_control(self) -> bool:
        """Whether control was granted, and no pilot has taken it."""
        return self.authority is not Authority.NONE

    @property
    def last_try(self) -> bool:
        """Whether the next try that fails is the last."""
        return self._tries >= self._retries

    def follows(self, event: MissionEvent, *, on_surface: bool, disarm_asked: bool) -> Branch | None:
        """What follows an event now; None: it means nothing."""
        circumstances = Circumstances(
            authority=self.authority,
            tries_left=not self.last_try,
            on_surface=on_surface,
            disarm_asked=disarm_asked,
        )
        return follows(self.state, event, circumstances)

    def take(self, branch: Branch) -> None:
        """Go where a branch leads."""
        self.state = branch.to or self.state
        self.authority = branch.authority or self.authority
        if Effect.COUNT_TRY in branch.effects:
            self._tries += 1
