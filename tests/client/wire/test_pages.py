"""Lists page by page: their limit, and where they end."""

from __future__ import annotations

from equimesh_client.wire.protocol import PAGE_RECORDS, Pages, SequencePages


def fetched(pages: Pages, sizes: list[int]) -> list[int]:
    """The numbers of records that are taken of pages with so many; all but the last page name a next one."""
    taken = []
    for number, size in enumerate(sizes, start=1):
        assert pages.more
        cursor = None if number == len(sizes) else f"after-{number}"
        taken.append(len(pages.records({"items": [{}] * size, "next_cursor": cursor})))
    return taken


def test_a_list_without_a_limit_goes_on_to_its_last_page() -> None:
    pages = Pages(status=None, label=None, limit=None)
    assert fetched(pages, [PAGE_RECORDS, 3]) == [PAGE_RECORDS, 3]
    assert not pages.more


def test_no_more_records_are_asked_for_than_the_limit() -> None:
    pages = Pages(status="failed", label="a", limit=PAGE_RECORDS + 2)
    assert pages.next_call().query["limit"] == str(PAGE_RECORDS)
    assert len(pages.records({"items": [{}] * PAGE_RECORDS, "next_cursor": "next"})) == PAGE_RECORDS
    assert pages.next_call().query == {"limit": "2", "cursor": "next", "status": "failed", "label": "a"}
    assert len(pages.records({"items": [{}] * 5, "next_cursor": "more"})) == 2
    assert not pages.more
    assert not Pages(status=None, label=None, limit=0).more


def test_sequences_have_a_list_of_their_own() -> None:
    assert SequencePages(limit=7).next_call().path == "/v1/sequences"
