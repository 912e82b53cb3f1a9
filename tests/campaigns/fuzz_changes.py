"""Bytes and values that are put into the place of right ones."""

from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

from tests.campaigns.fuzz_case import Special

ODD: tuple[Any, ...] = (
    0, -1, 1, 2, 0.5, float("nan"), float("inf"), -float("inf"), 1e308, 1e-320, 10**30, "", "abc", "a/b", None, True,
    [], {},
    [1.0], [[1.0]], [float("nan")] * 8, [1.0] * 8, [0.0] * 11, [-1.0] * 11, [1e308] * 11, {"a": 1}, "gru", "0" * 64,
    "x" * 4000,
)  # fmt: skip


@st.composite
def bytes_of(draw: Any, content: bytes, others: tuple[bytes, ...] = ()) -> bytes | Special:
    """`content` with bits flipped, cut, longer, in part zero; another file; or no file at all."""
    what = draw(st.integers(0, 11))
    broken = bytearray(content)
    if what <= 4:
        for _ in range(draw(st.sampled_from([1, 1, 2, 8, 30]))):
            near = draw(st.booleans())  # headers stand at the ends
            last = len(broken) - 1
            place = draw(st.integers(0, min(last, 400))) if near else draw(st.integers(0, last))
            place = last - place if draw(st.booleans()) else place
            broken[place] ^= 1 << draw(st.integers(0, 7))
    elif what == 5:
        del broken[draw(st.integers(0, len(broken) - 1)) :]
    elif what == 6:
        broken += draw(st.sampled_from([b"\0", b"more", bytes(10_000), bytes(content[:200])]))
    elif what == 7:
        start = draw(st.integers(0, len(broken) - 1))
        stop = min(len(broken), start + draw(st.sampled_from([1, 8, 100, 5000])))
        broken[start:stop] = bytes(stop - start)
    elif what == 8 and others:
        return draw(st.sampled_from(others))
    elif what == 9:
        return draw(st.sampled_from([b"", b"\0", b"{}", b"PK\x03\x04", b"\x89HDF\r\n\x1a\n", b"x" * 100]))
    elif what == 10:
        return draw(st.sampled_from([Special("folder"), Special("fifo"), Special("zero")]))
    else:  # a header of a gigabyte, claimed or there
        claim = draw(
            st.sampled_from([(2**30).to_bytes(8, "little"), b"\x3a\x80\x80\x80\x80\x04", b"\x80\x80\x80\x80\x04"])
        )
        if draw(st.booleans()):
            return Special("sparse", claim + bytes(content[:64]), 2**30 + 64)
        return claim + bytes(content)
    return bytes(broken)


@st.composite
def changed(draw: Any, content: bytes, inside: Callable[[Any, bytes], bytes], others: tuple[bytes, ...] = ()) -> Any:
    """Bytes or contents."""
    return inside(draw, content) if draw(st.integers(0, 2)) else draw(bytes_of(content, others))
