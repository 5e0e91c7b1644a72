"""JSON schemas of Foxglove's well-known messages that our logs hold, field by field as Foxglove defines them.

Source: Foxglove's documentation, "Message schemas". Times are {sec, nsec} since 1970; enums are numbers.
"""

from typing import Any, Final

Schema = dict[str, Any]

NUMBER: Final[Schema] = {"type": "number"}
INTEGER: Final[Schema] = {"type": "integer"}
STRING: Final[Schema] = {"type": "string"}
BOOLEAN: Final[Schema] = {"type": "boolean"}


def record(title: str, **properties: Schema) -> Schema:
    return {"type": "object", "title": title, "properties": properties}


def many(items: Schema, count: int | None = None) -> Schema:
    """An array of one kind of item; `count` of them where their number is fixed."""
    fixed = {} if count is None else {"minItems": count, "maxItems": count}
    return {"type": "array", "items": items, **fixed}


def choice(**values: int) -> Schema:
    """An enum: names and their numbers."""
    return {"oneOf": [{"title": name, "const": number} for name, number in values.items()]}


TIME: Final = record("time", sec=INTEGER, nsec=INTEGER)
DURATION: Final = record("duration", sec=INTEGER, nsec=INTEGER)
VECTOR: Final = record("foxglove.Vector3", x=NUMBER, y=NUMBER, z=NUMBER)
POINT2: Final = record("foxglove.Point2", x=NUMBER, y=NUMBER)
POINT3: Final = record("foxglove.Point3", x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION: Final = record("foxglove.Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
COLOUR: Final = record("foxglove.Color", r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
POSE: Final = record("foxglove.Pose", position=VECTOR, orientation=QUATERNION)
LINE: Final = record(
    "foxglove.LinePrimitive",
    type=choice(LINE_STRIP=0, LINE_LOOP=1, LINE_LIST=2),
    pose=POSE,
    thickness=NUMBER,
    scale_invariant=BOOLEAN,
    points=many(POINT3),
    color=COLOUR,
)
CUBE: Final = record("foxglove.CubePrimitive", pose=POSE, size=VECTOR, color=COLOUR)
SPHERE: Final = record("foxglove.SpherePrimitive", pose=POSE, size=VECTOR, color=COLOUR)
CYLINDER: Final = record(
    "foxglove.CylinderPrimitive", pose=POSE, size=VECTOR, bottom_scale=NUMBER, top_scale=NUMBER, color=COLOUR
)
ENTITY: Final = record(
    "foxglove.SceneEntity",
    timestamp=TIME,
    frame_id=STRING,
    id=STRING,
    lifetime=DURATION,
    frame_locked=BOOLEAN,
    cubes=many(CUBE),
    spheres=many(SPHERE),
    cylinders=many(CYLINDER),
    lines=many(LINE),
)
OUTLINE: Final = record(
    "foxglove.PointsAnnotation",
    timestamp=TIME,
    type=choice(UNKNOWN=0, POINTS=1, LINE_LOOP=2, LINE_STRIP=3, LINE_LIST=4),
    points=many(POINT2),
    outline_color=COLOUR,
    thickness=NUMBER,
)
LABEL: Final = record(
    "foxglove.TextAnnotation",
    timestamp=TIME,
    position=POINT2,
    text=STRING,
    font_size=NUMBER,
    text_color=COLOUR,
)
TRANSFORM: Final = record(
    "foxglove.FrameTransform",
    timestamp=TIME,
    parent_frame_id=STRING,
    child_frame_id=STRING,
    translation=VECTOR,
    rotation=QUATERNION,
)

# by name
SCHEMAS: Final[dict[str, Schema]] = {
    "foxglove.FrameTransform": TRANSFORM,
    "foxglove.PoseInFrame": record("foxglove.PoseInFrame", timestamp=TIME, frame_id=STRING, pose=POSE),
    "foxglove.SceneUpdate": record("foxglove.SceneUpdate", entities=many(ENTITY)),
    "foxglove.LocationFix": record(
        "foxglove.LocationFix",
        timestamp=TIME,
        frame_id=STRING,
        latitude=NUMBER,
        longitude=NUMBER,
        altitude=NUMBER,
        position_covariance=many(NUMBER, 9),
        position_covariance_type=choice(UNKNOWN=0, APPROXIMATED=1, DIAGONAL_KNOWN=2, KNOWN=3),
    ),
    "foxglove.CompressedImage": record(
        "foxglove.CompressedImage",
        timestamp=TIME,
        frame_id=STRING,
        data={"type": "string", "contentEncoding": "base64"},
        format=STRING,
    ),
    "foxglove.ImageAnnotations": record(
        "foxglove.ImageAnnotations", timestamp=TIME, points=many(OUTLINE), texts=many(LABEL)
    ),
    "foxglove.CameraCalibration": record(
        "foxglove.CameraCalibration",
        timestamp=TIME,
        frame_id=STRING,
        width=INTEGER,
        height=INTEGER,
        distortion_model=STRING,
        D=many(NUMBER),
        K=many(NUMBER, 9),
        R=many(NUMBER, 9),
        P=many(NUMBER, 12),
    ),
    "foxglove.Log": record(
        "foxglove.Log",
        timestamp=TIME,
        level=choice(UNKNOWN=0, DEBUG=1, INFO=2, WARNING=3, ERROR=4, FATAL=5),
        message=STRING,
        name=STRING,
        file=STRING,
        line=INTEGER,
    ),
}
