"""Walks through the mission's table."""

from companion.base.messages import ActionKind
from companion.plan.mission.states import Authority, Branch, Circumstances, MissionEvent, State
from companion.plan.mission.table import follows

E, S = MissionEvent, State
FLYING = Circumstances(authority=Authority.OURS)


def taken(state: State, event: MissionEvent, circumstances: Circumstances = FLYING) -> Branch:
    branch = follows(state, event, circumstances)
    assert branch is not None
    return branch


def kinds(branch: Branch) -> list[ActionKind]:
    return [action.kind for action in branch.actions]
