"""An executable of XLA's for CPUs without what neither loading nor running it needs.

XLA serialises, beside the machine code and the sequence of calls that runs it, the whole program
that both were made from: each operation with its name in the source, its lines and stack frames.
Reading that back is nearly all of the time that loading takes. Here the bodies of what is machine
code are left out, with what is said of operations for people. The protocol buffers are XLA's own
and come without a promise (`hlo.proto`, `executable.proto`, `thunk.proto`): what comes of this is
believed only where it runs to the same bits (`program_store`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from difffric.compute.programs.protobuf_wire import (
    Field,
    Value,
    edit_fields,
    find_bytes,
    find_one,
    find_whole,
    read_fields,
    read_varint,
    write_fields,
)

_CODE, _MODULE, _BUFFERS, _THUNKS = 1, 1, 2, 6
"""An executable's compiled code; of that, the module with its settings, how buffers are laid out,
and the calls that run it."""
_PROGRAM, _NAME, _COMPUTATIONS, _ENTRY, _FRAMES = 1, 1, 3, 6, 17
"""Of the module with its settings: the module; its name, its computations, the number of that where
it begins, the source's stack frames."""
_INSTRUCTIONS, _NUMBER = 2, 5
"""Of a computation."""
_OPERATION, _METADATA, _KIND, _TARGET, _ID, _CALLED = 2, 7, 11, 28, 35, 38
"""Of an instruction: what it does, where it stands in the source, of a fusion its kind, of a custom
call its target, its number, the computations that it calls."""
_STATISTICS, _ORIGINAL = 82, 88
"""Of an instruction: what is said for people."""
_LOGICAL, _ALIAS, _ALLOCATION, _HEAP, _PEAK = 1, 2, 3, 4, 5
"""Of the buffers: logical ones, aliases, allocations, and a trace and peaks for people."""
_DEFINED, _ASSIGNED, _CONSTANT, _PLACE, _INSTRUCTION = 3, 9, 12, 2, 4
"""Of a logical buffer, an allocation twice, an alias and a location."""
_THUNK, _INFO, _KERNEL, _OP_NAME = 1, 2, 11, 1
"""Of the calls: one, what it is of, the kernel if it is one; the instruction's name."""
_NESTED = {3: (1,), 4: (1,), 10: (1, 2)}
"""Calls that hold others, and where: a call, a branch, a loop."""
_CUSTOM = b"kCustom"
"""The kind of fusion that is run from its body, by a library."""


def strip(executable: bytes) -> bytes:
    """The executable without what loading and running it does not need.

    Raises `ValueError` where it is not laid out as expected.
    """
    head, body = _split(executable)
    return head + edit_fields(
        body, lambda n, v: _strip_code(_check_message(v)) if n == _CODE else v
    )


def find_targets(executable: bytes) -> set[str]:
    """The names of the functions outside of the program that it calls.

    Raises `ValueError` where the executable is not laid out as expected.
    """
    code = _read_one(_split(executable)[1], _CODE)
    module = _read_one(_read_one(code, _MODULE), _PROGRAM)
    return {
        target.decode()
        for computation in find_bytes(module, _COMPUTATIONS)
        for instruction in find_bytes(computation, _INSTRUCTIONS)
        for target in find_bytes(instruction, _TARGET)
    }


def _split(executable: bytes) -> tuple[bytes, bytes]:
    """What JAX put in front, and XLA's own part."""
    length, at = read_varint(executable, 0)
    if at + length >= len(executable):
        raise ValueError("an executable ends within its head")
    return executable[: at + length], executable[at + length :]


def _check_message(value: Value) -> bytes:
    if isinstance(value, int):
        raise ValueError("a number where a message was expected")
    return value


def _read_one(message: bytes, number: int) -> bytes:
    found = find_bytes(message, number)
    if len(found) != 1:
        raise ValueError(f"expected one field {number}, got {len(found)}")
    return found[0]


def _strip_code(code: bytes) -> bytes:
    compiled = _find_kernels(_read_one(code, _THUNKS))
    with_settings = _read_one(code, _MODULE)
    constants = _find_constants(_read_one(code, _BUFFERS))
    module = _Module(_read_one(with_settings, _PROGRAM), compiled, constants)
    small = edit_fields(with_settings, lambda n, v: module.write() if n == _PROGRAM else v)
    buffers = _strip_buffers(_read_one(code, _BUFFERS), module.kept)
    return edit_fields(code, lambda n, v: {_MODULE: small, _BUFFERS: buffers}.get(n, v))


def _find_kernels(sequence: bytes) -> set[bytes]:
    """The names of the instructions that machine code stands for."""
    out: set[bytes] = set()
    for thunk in find_bytes(sequence, _THUNK):
        for number, _, value in read_fields(thunk):
            if number == _KERNEL:
                out.update(find_bytes(_read_one(thunk, _INFO), _OP_NAME))
            for inner in _NESTED.get(number, ()):
                for nested in find_bytes(_check_message(value), inner):
                    out |= _find_kernels(nested)
    return out


@dataclass
class _Module:
    """A module of which only what is reached is kept, from where it begins."""

    message: bytes
    compiled: set[bytes]
    """names of instructions whose bodies are machine code"""
    constants: set[int]
    """numbers of the instructions whose values loading puts into buffers"""
    kept: set[int] = field(default_factory=set)
    """numbers of the instructions that stay"""

    def __post_init__(self) -> None:
        every = {find_one(c, _NUMBER): c for c in find_bytes(self.message, _COMPUTATIONS)}
        self.computations: dict[int, bytes] = {}
        self.holding = self._find_holding(every)
        reached = [find_one(self.message, _ENTRY)]
        while reached:
            number = reached.pop()
            if number not in self.computations:
                called: list[int] = []
                self.computations[number] = self._strip_computation(every[number], called)
                reached += called

    def _find_holding(self, every: dict[int, bytes]) -> set[int]:
        """The numbers of the computations with such a constant, their own or in one they call."""
        holding: set[int] = set()
        for number, computation in every.items():  # what is called stands before what calls it
            for instruction in find_bytes(computation, _INSTRUCTIONS):
                own = holding.intersection(find_whole(instruction, _CALLED))
                if own or find_one(instruction, _ID) in self.constants:
                    holding.add(number)
        return holding

    def write(self) -> bytes:
        """The module's message."""

        def edit(number: int, value: Value) -> Value | None:
            if number == _COMPUTATIONS:
                return self.computations.get(find_one(_check_message(value), _NUMBER))
            return None if number == _FRAMES else value

        return edit_fields(self.message, edit)

    def _strip_computation(self, computation: bytes, called: list[int]) -> bytes:
        """A computation's message; the numbers of those that it still calls join `called`."""

        def edit(number: int, value: Value) -> Value:
            if number != _INSTRUCTIONS:
                return value
            self.kept.add(find_one(_check_message(value), _ID))
            return self._strip_instruction(_check_message(value), called)

        return edit_fields(computation, edit)

    def _strip_instruction(self, instruction: bytes, called: list[int]) -> bytes:
        """An instruction's message. One that is machine code becomes a call of something outside:
        loading asks for its shape and operands alone."""
        fields = [
            x for x in read_fields(instruction) if x[0] not in (_METADATA, _STATISTICS, _ORIGINAL)
        ]
        own = find_whole(instruction, _CALLED)
        names, kinds = find_bytes(instruction, _NAME), find_bytes(instruction, _KIND)
        needed = _CUSTOM in kinds or bool(self.holding.intersection(own))
        if not own or names[0] not in self.compiled or needed:
            called += own
            return write_fields(fields)
        outside: list[Field] = [(n, w, v) for n, w, v in fields if n not in (_KIND, _CALLED)]
        outside = [(n, w, b"custom-call" if n == _OPERATION else v) for n, w, v in outside]
        return write_fields([*outside, (_TARGET, 2, b"compiled")])


def _find_constants(buffers: bytes) -> set[int]:
    """The numbers of the instructions that define the buffers of constants."""
    assigned = {
        find_one(one, 1)
        for allocation in find_bytes(buffers, _ALLOCATION)
        if find_one(allocation, _CONSTANT)
        for one in find_bytes(allocation, _ASSIGNED)
    }
    return {
        find_one(_read_one(logical, _DEFINED), _INSTRUCTION)
        for logical in find_bytes(buffers, _LOGICAL)
        if find_one(logical, 1) in assigned
    }


def _strip_buffers(buffers: bytes, kept: set[int]) -> bytes:
    """How buffers are laid out, of the instructions that are `kept`."""

    def stays(location: bytes) -> bool:
        return find_one(location, _INSTRUCTION) in kept

    def edit(number: int, value: Value) -> Value | None:
        if number in (_HEAP, _PEAK):
            return None
        message = _check_message(value)
        if number == _LOGICAL and not stays(_read_one(message, _DEFINED)):
            gone.add(find_one(message, 1))
            return None
        if number == _ALIAS and (
            find_one(message, 1) in gone or not stays(_read_one(message, _PLACE))
        ):
            return None
        return edit_fields(message, edit_allocation) if number == _ALLOCATION else value

    def edit_allocation(number: int, value: Value) -> Value | None:
        return None if number == _ASSIGNED and find_one(_check_message(value), 1) in gone else value

    # Logical buffers come before what names them, as XLA writes them.
    gone: set[int] = set()
    return edit_fields(buffers, edit)
