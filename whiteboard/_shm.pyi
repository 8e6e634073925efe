from collections.abc import Callable
from typing import Self, TypeVar, final

from .board import BoundSlot, Sample
from .message import Message
from .shared import Field

_M = TypeVar("_M", bound=Message)

@final
class Board:
    def __new__(cls, path: str, create: bool) -> Self: ...
    def close(self) -> None: ...
    def linked(self) -> bool: ...
    def shared(self) -> bool: ...
    def slots(self) -> list[tuple[str, str, bytes, int, int]]: ...

@final
class Port(BoundSlot[_M]):
    def __new__(
        cls,
        board: Board,
        name: str,
        type_name: str,
        schema: str,
        fingerprint: int,
        capacity: int,
        message_type: type[_M],
        fields: tuple[Field, ...],
        encode_into: Callable[[_M, bytearray], None],
        decode: Callable[[bytes], _M],
    ) -> Self: ...
    @property
    def count(self) -> int: ...
    @property
    def capacity(self) -> int: ...
    def add(self, message: _M, /) -> int: ...
    def get(self) -> _M | None: ...
    def sample(self) -> Sample[_M] | None: ...
    def wait(self, *, after: int, timeout: float | None = None) -> Sample[_M] | None: ...
