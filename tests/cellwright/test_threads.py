from __future__ import annotations

from cellwright.threads import map_slices, slices_of


def test_slices_cover_all_rows_once_and_in_order() -> None:
    rows = [row for piece in slices_of(10, 4) for row in range(10)[piece]]
    assert rows == list(range(10))
    assert list(slices_of(0, 4)) == []


def test_results_come_in_the_order_of_the_slices_whatever_the_number_of_threads() -> None:
    expected = [(0, 3), (3, 6), (6, 7)]
    for n_threads in (None, 1, 2, 5):
        found = list(map_slices(lambda rows: (rows.start, rows.stop), 7, 3, n_threads=n_threads))
        assert found == expected
