"""What an ONNX file holds, as protobuf messages: the part of onnx.proto3 that is read and checked here.

The package onnx, which has all of it, comes with the extra `train`: a program that only runs networks starts in a third
of the time without. Fields that are not listed here are kept when a message is written again.
"""

import functools
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

# By message: its fields as "NAME NUMBER TYPE", a list with a star; a type that is no scalar is a message.
_FIELDS = {
    "Pair": "key 1 string, value 2 string",
    "Tensor": "dims* 1 int64, data_type 2 int32, float_data* 4 float, int32_data* 5 int32, name 8 string, "
    "raw_data 9 bytes, double_data* 10 double, external_data* 13 Pair, data_location 14 int32",
    "Attribute": "name 1 string, t 5 Tensor, g 6 Graph, tensors* 10 Tensor, graphs* 11 Graph, sparse_tensor 22 bytes, "
    "sparse_tensors* 23 bytes",
    "Node": "input* 1 string, op_type 4 string, domain 7 string, attribute* 5 Attribute",
    "Graph": "node* 1 Node, initializer* 5 Tensor, sparse_initializer* 15 bytes",
    "Function": "name 1 string",
    "Model": "graph 7 Graph, metadata_props* 14 Pair, functions* 25 Function",
}


@functools.cache
def _model_class() -> type:
    file = descriptor_pb2.FileDescriptorProto(name="onnx_subset.proto", package="onnx_subset", syntax="proto3")
    for message, fields in _FIELDS.items():
        entry = file.message_type.add(name=message)
        for words in fields.split(", "):
            name, number, kind = words.split()
            field = entry.field.add(name=name.rstrip("*"), number=int(number))
            field.label = field.LABEL_REPEATED if name.endswith("*") else field.LABEL_OPTIONAL
            if kind in _FIELDS:
                field.type, field.type_name = field.TYPE_MESSAGE, f".onnx_subset.{kind}"
            else:
                field.type = getattr(field, f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("onnx_subset.Model"))


def parse_model(content: bytes) -> Any:
    """The model in the bytes of an ONNX file; raises ValueError where they are none."""
    from google.protobuf.message import DecodeError

    try:
        return _model_class().FromString(content)  # type: ignore[attr-defined]
    except DecodeError as error:
        raise ValueError(str(error)) from error
