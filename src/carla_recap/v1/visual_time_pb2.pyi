from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class VisualTime(_message.Message):
    __slots__ = ("frame", "elapsed", "seconds", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    seconds: float
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., seconds: _Optional[float] = ..., raw: _Optional[bytes] = ...) -> None: ...
