"""What crosses a border between stages: frozen dataclasses in SI units.

`time_s` is when the thing was measured on the app's monotonic clock (a frame: mid-exposure), never when
it arrived. Frames are in the field's name: `_ned_`, `_body_` (FRD), `_camera_`, `_pad_`.

Relative motion is the pad minus the vehicle's reference point, from the sighting to the controller. A place
in a frame that begins at the pad (`Reference` with origin "pad") is a place like any other: it counts from
the frame's origin.
"""

from companion.base.messages.control import (
    ControlReport,
    Setpoint,
)
from companion.base.messages.estimate import (
    EstimatorInputs,
    InputUse,
    PadState,
    VehicleState,
)
from companion.base.messages.link import (
    UNKNOWN_TIMEOUT_S,
    AutopilotSetup,
    AutopilotState,
    LandedState,
    PadBeacon,
)
from companion.base.messages.order import (
    Order,
    OrderKind,
    OrderOutcome,
    OrderReply,
    Refusal,
)
from companion.base.messages.plan import (
    Action,
    ActionKind,
    ActionResult,
    Conditions,
    DescentCone,
    LevelOff,
    Notice,
    Outcome,
    Phase,
    PlanStep,
    Reference,
)
from companion.base.messages.sense import (
    AutopilotAttitude,
    Frame,
    FrameReport,
    GpsFix,
    ImuSample,
    MagSample,
    MarkerGroup,
    PadPrior,
    PadSighting,
    RangeSample,
)
from companion.base.messages.sources import (
    Quantity,
    SourceComparison,
)
from companion.base.messages.truth import (
    Truth,
)

__all__ = [
    "UNKNOWN_TIMEOUT_S",
    "Action",
    "ActionKind",
    "ActionResult",
    "AutopilotAttitude",
    "AutopilotSetup",
    "AutopilotState",
    "Conditions",
    "ControlReport",
    "DescentCone",
    "EstimatorInputs",
    "Frame",
    "FrameReport",
    "GpsFix",
    "ImuSample",
    "InputUse",
    "LandedState",
    "LevelOff",
    "MagSample",
    "MarkerGroup",
    "Notice",
    "Order",
    "OrderKind",
    "OrderOutcome",
    "OrderReply",
    "Outcome",
    "PadBeacon",
    "PadPrior",
    "PadSighting",
    "PadState",
    "Phase",
    "PlanStep",
    "Quantity",
    "RangeSample",
    "Reference",
    "Refusal",
    "Setpoint",
    "SourceComparison",
    "Truth",
    "VehicleState",
]
