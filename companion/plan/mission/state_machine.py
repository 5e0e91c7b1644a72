"""The state of the mission: phase, who has control, number of tries used. The mission's table changes it."""

from dataclasses import replace

from companion.base.messages import Phase
from companion.plan.events import MissionEvent
from companion.plan.mission.states import Authority, Branch, Circumstances, Effect, State
from companion.plan.mission.table import TABLE, follows


class StateMachine:
    """Asks the table what follows, and takes it."""

    def __init__(self, retries: int, *, may_fly: bool = True) -> None:
        """Ready to connect; in standby, if it may not fly until it is ordered to."""
        self._retries = retries
        self._tries = 0
        self.no_new_try = False  # whatever is left of the tries: the battery is low
        self.state = State.CONNECT if may_fly else State.STANDBY
        self.authority = Authority.NONE
        self.ordered_in_air = False  # somebody else flies it until control is ours

    @property
    def phase(self) -> Phase:
        """The phase of the present state."""
        return self.state.phase

    @property
    def in_control(self) -> bool:
        """Whether control was granted, though it may have been returned or taken since."""
        return self.authority is not Authority.NONE

    @property
    def last_try(self) -> bool:
        """Whether the next try that fails is the last."""
        return self.no_new_try or self._tries >= self._retries

    def heeds(self, event: MissionEvent) -> bool:
        """Whether an event may mean anything in the present state."""
        return bool(TABLE[self.state, event])

    def follows(self, event: MissionEvent, circumstances: Circumstances) -> Branch | None:
        """What follows an event now; None: it means nothing. Authority and tries are the machine's own."""
        ours = replace(
            circumstances,
            authority=self.authority,
            tries_left=not self.last_try,
            ordered_in_air=self.ordered_in_air,
        )
        return follows(self.state, event, ours)

    def take(self, branch: Branch) -> None:
        """Go where a branch leads."""
        if self.state is State.STANDBY and branch.to is State.SEARCH:
            self.ordered_in_air = True
        self.state = branch.to or self.state
        self.authority = branch.authority or self.authority
        if Effect.COUNT_TRY in branch.effects:
            self._tries += 1
