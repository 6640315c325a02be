# SPDX-License-Identifier: Apache-2.0
"""Types of type_description_interfaces for ros2_peer.py, in addition to ros2_peer_types.py."""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import bounded_str, int64, sequence, uint8, uint64

DESCRIPTIONS = "type_description_interfaces::msg::dds_::"


@dataclass
class FieldType(IdlStruct, typename=DESCRIPTIONS + "FieldType_"):
    type_id: uint8
    capacity: uint64
    string_capacity: uint64
    nested_type_name: bounded_str[255]


@dataclass
class Field(IdlStruct, typename=DESCRIPTIONS + "Field_"):
    name: str
    type: FieldType
    default_value: str


@dataclass
class IndividualTypeDescription(IdlStruct, typename=DESCRIPTIONS + "IndividualTypeDescription_"):
    type_name: bounded_str[255]
    fields: sequence[Field]


@dataclass
class TypeDescription(IdlStruct, typename=DESCRIPTIONS + "TypeDescription_"):
    type_description: IndividualTypeDescription
    referenced_type_descriptions: sequence[IndividualTypeDescription]


@dataclass
class TypeSource(IdlStruct, typename=DESCRIPTIONS + "TypeSource_"):
    type_name: str
    encoding: str
    raw_file_contents: str


@dataclass
class TypeKeyValue(IdlStruct, typename=DESCRIPTIONS + "KeyValue_"):
    key: str
    value: str


DESCRIBE = "type_description_interfaces::srv::dds_::GetTypeDescription"


@dataclass
class DescribeRequest(IdlStruct, typename=DESCRIBE + "_Request_"):
    guid: uint64
    seq: int64
    type_name: str
    type_hash: str
    include_type_sources: bool


@dataclass
class DescribeReply(IdlStruct, typename=DESCRIBE + "_Response_"):
    guid: uint64
    seq: int64
    successful: bool
    failure_reason: str
    type_description: TypeDescription
    type_sources: sequence[TypeSource]
    extra_information: sequence[TypeKeyValue]
