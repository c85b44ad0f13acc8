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

class PlatformTime(_message.Message):
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

class FrameCounter(_message.Message):
    __slots__ = ("frame", "elapsed", "count", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    count: int
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., count: _Optional[int] = ..., raw: _Optional[bytes] = ...) -> None: ...

class RawPacket(_message.Message):
    __slots__ = ("frame", "elapsed", "id", "size", "data")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ID_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    id: int
    size: int
    data: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., id: _Optional[int] = ..., size: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...

class Tail(_message.Message):
    __slots__ = ("data",)
    DATA_FIELD_NUMBER: _ClassVar[int]
    data: bytes
    def __init__(self, data: _Optional[bytes] = ...) -> None: ...
