"""Server-Sent Events: the parser, and the position over several connections."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from equimesh_client.wire.stream import Event, EventParser, RawEvent, StreamPosition


def parsed(*chunks: bytes) -> list[RawEvent]:
    parser = EventParser()
    return [event for chunk in chunks for event in parser.feed(chunk)]


STREAM = (
    b'\xef\xbb\xbf: hello\r\n\r\nid: 1\nevent: status\ndata: {"a":\ndata: 1}\n\n'
    + "id:2\revent:progress\rdata:größe\r\rid: 3\r\ndata: x\r\n\r\n".encode()
    + b"id: 4\ndata: lost"
)
EVENTS = [
    RawEvent(id="1", kind="status", data='{"a":\n1}'),
    RawEvent(id="2", kind="progress", data="größe"),
    RawEvent(id="3", kind="message", data="x"),
]


def test_all_line_ends_comments_and_fields() -> None:
    assert parsed(STREAM) == EVENTS


@given(st.lists(st.integers(0, len(STREAM)), max_size=12))
def test_pieces_of_any_size_give_the_same(cuts: list[int]) -> None:
    bounds = [0, *sorted(cuts), len(STREAM)]
    assert parsed(*(STREAM[i:j] for i, j in pairwise(bounds))) == EVENTS


def test_an_event_without_data_is_none() -> None:
    assert parsed(b"id: 1\nevent: status\n\n") == []


def test_retry_is_in_milliseconds() -> None:
    parser = EventParser()
    parser.feed(b"retry: 1500\nretry: x\n\n")
    assert parser.retry == 1.5


def test_a_position_gives_every_event_once() -> None:
    position = StreamPosition()
    assert position.headers == {}
    first = position.feed(b"id: 1\nevent: status\ndata: {}\n\nid: 2\nevent: progress\ndata: 7\n\nid: 3\nda")
    assert first == [Event(id=1, kind="status", data={}), Event(id=2, kind="progress", data={"value": 7})]
    assert position.headers == {"Last-Event-ID": "2"}
    position.connected()
    again = position.feed(b"id: 2\nevent: progress\ndata: 7\n\nid: 3\nevent: done\ndata: {}\n\nid: 4\ndata: {}\n\n")
    assert [event.id for event in again] == [3]
    assert position.done


def test_a_new_event_forgives_failures() -> None:
    position = StreamPosition(failures=3)
    position.feed(b": still here\n\n")
    assert position.failures == 3
    position.feed(b"id: 1\nevent: status\ndata: {}\n\n")
    assert position.failures == 0


def test_a_message_without_a_number_is_a_keep_alive() -> None:
    assert StreamPosition().feed(b"event: ping\ndata: {}\n\nid: x\ndata: {}\n\n") == []
