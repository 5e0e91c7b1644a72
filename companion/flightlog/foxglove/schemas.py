"""JSON schemas of Foxglove's well-known messages that our logs hold, field by field as Foxglove defines them.

Source: Foxglove's documentation, "Message schemas". Times are {sec, nsec} since 1970; enums are numbers.
"""

from typing import Any, Final

Schema = dict[str, Any]

# Of each message its fields, a name and a kind each: JSON's own, another message, an enum's words from 0 on;
# [] are several of a kind, [9] so many.
PARTS: Final = {
    "time": "sec:integer nsec:integer",
    "duration": "sec:integer nsec:integer",
    "Vector3": "x:number y:number z:number",
    "Point2": "x:number y:number",
    "Point3": "x:number y:number z:number",
    "Quaternion": "x:number y:number z:number w:number",
    "Color": "r:number g:number b:number a:number",
    "Pose": "position:Vector3 orientation:Quaternion",
    "LinePrimitive": "type:LINE_STRIP|LINE_LOOP|LINE_LIST pose:Pose thickness:number scale_invariant:boolean "
    "points:Point3[] color:Color",
    "CubePrimitive": "pose:Pose size:Vector3 color:Color",
    "SpherePrimitive": "pose:Pose size:Vector3 color:Color",
    "CylinderPrimitive": "pose:Pose size:Vector3 bottom_scale:number top_scale:number color:Color",
    "SceneEntity": "timestamp:time frame_id:string id:string lifetime:duration frame_locked:boolean "
    "cubes:CubePrimitive[] spheres:SpherePrimitive[] cylinders:CylinderPrimitive[] lines:LinePrimitive[]",
    "PointsAnnotation": "timestamp:time type:UNKNOWN|POINTS|LINE_LOOP|LINE_STRIP|LINE_LIST points:Point2[] "
    "outline_color:Color thickness:number",
    "TextAnnotation": "timestamp:time position:Point2 text:string font_size:number text_color:Color",
}
# what stands under a topic of its own
LOGGED: Final = {
    "FrameTransform": "timestamp:time parent_frame_id:string child_frame_id:string translation:Vector3 "
    "rotation:Quaternion",
    "PoseInFrame": "timestamp:time frame_id:string pose:Pose",
    "SceneUpdate": "entities:SceneEntity[]",
    "LocationFix": "timestamp:time frame_id:string latitude:number longitude:number altitude:number "
    "position_covariance:number[9] position_covariance_type:UNKNOWN|APPROXIMATED|DIAGONAL_KNOWN|KNOWN",
    "CompressedImage": "timestamp:time frame_id:string data:base64 format:string",
    "ImageAnnotations": "timestamp:time points:PointsAnnotation[] texts:TextAnnotation[]",
    "CameraCalibration": "timestamp:time frame_id:string width:integer height:integer "
    "distortion_model:string D:number[] K:number[9] R:number[9] P:number[12]",
    "Log": "timestamp:time level:UNKNOWN|DEBUG|INFO|WARNING|ERROR|FATAL message:string name:string "
    "file:string line:integer",
}
FIELDS: Final = PARTS | LOGGED


def _schema(kind: str) -> Schema:
    if kind.endswith("]"):
        item, _, count = kind[:-1].rpartition("[")
        fixed = {"minItems": int(count), "maxItems": int(count)} if count else {}
        return {"type": "array", "items": _schema(item), **fixed}
    if "|" in kind:
        return {"oneOf": [{"title": word, "const": number} for number, word in enumerate(kind.split("|"))]}
    if kind == "base64":
        return {"type": "string", "contentEncoding": "base64"}
    if kind not in FIELDS:
        return {"type": kind}
    fields = (field.split(":") for field in FIELDS[kind].split())
    title = kind if kind in ("time", "duration") else f"foxglove.{kind}"
    return {"type": "object", "title": title, "properties": {name: _schema(inner) for name, inner in fields}}


# by name
SCHEMAS: Final[dict[str, Schema]] = {f"foxglove.{kind}": _schema(kind) for kind in LOGGED}
