"""Foxglove's own definitions of its messages, and plain data as such a message."""

from typing import Any

import foxglove.messages
from google.protobuf import descriptor_pb2, message_factory


def official(name: str) -> Any:
    """The message class that Foxglove's SDK describes."""
    schema = getattr(foxglove.messages, name.removeprefix("foxglove.")).get_schema()
    files = descriptor_pb2.FileDescriptorSet()
    files.ParseFromString(schema.data)
    return message_factory.GetMessages(files.file)[schema.name]


def as_proto(descriptor: Any, plain: Any) -> Any:
    """Our JSON as protobuf's JSON, which differs in the form of times alone."""
    if descriptor is None or not isinstance(plain, dict):
        return plain
    if descriptor.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
        assert plain.keys() == {"sec", "nsec"}
        assert all(isinstance(number, int) for number in plain.values())
        if descriptor.name == "Duration":
            return f"{plain['sec']}.{plain['nsec']:09d}s"
        return f"2020-01-01T00:00:00.{plain['nsec']:09d}Z"
    out = {}
    for key, value in plain.items():
        assert key in descriptor.fields_by_name, f"{descriptor.full_name} has no {key}"
        inner = descriptor.fields_by_name[key].message_type
        several = isinstance(value, list)
        out[key] = [as_proto(inner, item) for item in value] if several else as_proto(inner, value)
    return out
