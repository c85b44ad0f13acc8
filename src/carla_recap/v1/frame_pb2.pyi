from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Frame(_message.Message):
    __slots__ = ("frame", "elapsed", "duration", "packets", "filled")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    DURATION_FIELD_NUMBER: _ClassVar[int]
    PACKETS_FIELD_NUMBER: _ClassVar[int]
    FILLED_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    duration: float
    packets: bytes
    filled: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., duration: _Optional[float] = ..., packets: _Optional[bytes] = ..., filled: _Optional[bytes] = ...) -> None: ...
