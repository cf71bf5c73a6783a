"""Messages are read and written without their schema: what is not edited stays bit for bit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from difffric.compute.programs import protobuf_wire as wire

numbers = st.integers(1, 2**29 - 1)
FIELDS = st.lists(
    st.one_of(
        st.tuples(numbers, st.just(0), st.integers(0, 2**64 - 1)),
        st.tuples(numbers, st.just(1), st.binary(min_size=8, max_size=8)),
        st.tuples(numbers, st.just(2), st.binary(max_size=300)),
        st.tuples(numbers, st.just(5), st.binary(min_size=4, max_size=4)),
    )
)


@given(FIELDS)
def test_fields_are_read_as_they_were_written(fields):
    message = wire.write_fields(fields)
    assert list(wire.read_fields(message)) == fields
    assert wire.edit_fields(message, lambda number, value: value) == message


@given(FIELDS.filter(bool), st.data())
def test_a_message_that_is_cut_short_is_none(fields, data):
    message = wire.write_fields(fields)
    last = len(wire.write_fields(fields[-1:]))
    with pytest.raises(ValueError, match="ends within"):
        list(wire.read_fields(message[: -data.draw(st.integers(1, last - 1))]))


def test_known_messages():
    """The first two are of the documentation of protocol buffers."""
    assert wire.find_whole(bytes.fromhex("08 96 01"), 1) == [150]
    assert wire.find_bytes(bytes.fromhex("12 07 74 65 73 74 69 6e 67"), 2) == [b"testing"]
    assert wire.find_whole(bytes.fromhex("32 06 03 8e 02 9e a7 05"), 6) == [3, 270, 86942]
    assert wire.find_one(b"", 1) == 0
    with pytest.raises(ValueError, match="wire type"):
        list(wire.read_fields(b"\x0b"))
