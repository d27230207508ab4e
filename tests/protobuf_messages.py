"""Protobuf messages decoded by Google's own library from the schemas in files, for tests."""

from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass


def message_class(schema: bytes, name: str) -> Any:
    """The class of the message `name` of a FileDescriptorSet; another pool for each, so that it must be complete."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(name))
