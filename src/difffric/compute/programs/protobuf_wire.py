"""Messages of Google's protocol buffers, read and written without their schema.

A message is a row of fields, each with its number and a value: a whole number, so many bytes (a
text, or a message again), or four or eight bytes. Fields that are not looked at are copied as they
are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

Value = int | bytes
Field = tuple[int, int, Value]
"""(number, wire type, value)"""

_WHOLE, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
"""The wire types."""


def read_varint(data: bytes, at: int) -> tuple[int, int]:
    """The whole number that begins `at`, and where it ends. Raises `ValueError` at the end."""
    value = shift = 0
    while at < len(data):
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    raise ValueError("a message ends within a number")


def write_varint(value: int) -> bytes:
    """A whole number >= 0, seven bits a byte, the lowest first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def read_fields(message: bytes) -> Iterator[Field]:
    """The fields of a message. Raises `ValueError` for what is no message."""
    at = 0
    while at < len(message):
        key, at = read_varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == _WHOLE:
            value, at = read_varint(message, at)
            yield number, kind, value
            continue
        if kind == _BYTES:
            length, at = read_varint(message, at)
        elif kind in (_EIGHT, _FOUR):
            length = 8 if kind == _EIGHT else 4
        else:
            raise ValueError(f"no such wire type: {kind}")
        if at + length > len(message):
            raise ValueError("a message ends within a field")
        yield number, kind, message[at : at + length]
        at += length


def write_fields(fields: Iterable[Field]) -> bytes:
    """The message of these fields."""
    parts = []
    for number, kind, value in fields:
        parts.append(write_varint(number << 3 | kind))
        if isinstance(value, int):
            parts.append(write_varint(value))
        else:
            if kind == _BYTES:
                parts.append(write_varint(len(value)))
            parts.append(value)
    return b"".join(parts)


def edit_fields(message: bytes, edit: Callable[[int, Value], Value | None]) -> bytes:
    """The message with each field's value as `edit(number, value)` gives it; None leaves it out."""
    edited = ((number, kind, edit(number, value)) for number, kind, value in read_fields(message))
    return write_fields((n, kind, value) for n, kind, value in edited if value is not None)


def find_bytes(message: bytes, number: int) -> list[bytes]:
    """The values of the fields of this number: texts, or messages."""
    return [v for n, _, v in read_fields(message) if n == number and isinstance(v, bytes)]


def find_whole(message: bytes, number: int) -> list[int]:
    """The whole numbers in the fields of this number, whether they stand alone or packed."""
    out: list[int] = []
    for n, _, value in read_fields(message):
        if n != number:
            continue
        if isinstance(value, int):
            out.append(value)
            continue
        at = 0
        while at < len(value):
            one, at = read_varint(value, at)
            out.append(one)
    return out


def find_one(message: bytes, number: int) -> int:
    """The whole number in the field of this number; a field that is not there is 0."""
    return (find_whole(message, number) or [0])[-1]
