from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Contact(_message.Message):
    __slots__ = ("index", "actor1", "actor2", "x1", "y1", "z1", "x2", "y2", "z2", "velocity_x1", "velocity_y1", "velocity_z1", "velocity_x2", "velocity_y2", "velocity_z2")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    ACTOR1_FIELD_NUMBER: _ClassVar[int]
    ACTOR2_FIELD_NUMBER: _ClassVar[int]
    X1_FIELD_NUMBER: _ClassVar[int]
    Y1_FIELD_NUMBER: _ClassVar[int]
    Z1_FIELD_NUMBER: _ClassVar[int]
    X2_FIELD_NUMBER: _ClassVar[int]
    Y2_FIELD_NUMBER: _ClassVar[int]
    Z2_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_X1_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_Y1_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_Z1_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_X2_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_Y2_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_Z2_FIELD_NUMBER: _ClassVar[int]
    index: int
    actor1: int
    actor2: int
    x1: float
    y1: float
    z1: float
    x2: float
    y2: float
    z2: float
    velocity_x1: float
    velocity_y1: float
    velocity_z1: float
    velocity_x2: float
    velocity_y2: float
    velocity_z2: float
    def __init__(self, index: _Optional[int] = ..., actor1: _Optional[int] = ..., actor2: _Optional[int] = ..., x1: _Optional[float] = ..., y1: _Optional[float] = ..., z1: _Optional[float] = ..., x2: _Optional[float] = ..., y2: _Optional[float] = ..., z2: _Optional[float] = ..., velocity_x1: _Optional[float] = ..., velocity_y1: _Optional[float] = ..., velocity_z1: _Optional[float] = ..., velocity_x2: _Optional[float] = ..., velocity_y2: _Optional[float] = ..., velocity_z2: _Optional[float] = ...) -> None: ...

class Contacts(_message.Message):
    __slots__ = ("frame", "elapsed", "contacts")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    CONTACTS_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    contacts: _containers.RepeatedCompositeFieldContainer[Contact]
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., contacts: _Optional[_Iterable[_Union[Contact, _Mapping]]] = ...) -> None: ...
