from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from cellwright.errors import InvalidInputError, LakeError
from schemas.artefact import Artefact
from schemas.columns import column
from schemas.references import Ref
from schemas.sources import SourceFile
from schemas.views import Measurability, Viewpoints, ViewSelection
from storage.lake import Lake
from storage.manifests import Recipe
from tests.storage.specimens import recipe, tally
from tests.storage.test_mcap import plan

DOCUMENT = Path(__file__).parents[2] / "docs" / "lake.md"
STATEMENTS = re.findall(r"```sql\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def filled(lake: Lake) -> Lake:
    """A small lake: a part, candidates, what they measure, two selections, a recording, a recorded run."""

    def add(stage: str, artefact: Artefact, inputs: dict[str, str], **params: float) -> Ref:
        about = Recipe(stage, 1, params, inputs)
        provenance = {"run": "one", "seconds": 0.5, "versions": {"coal": "3.0.0"}}
        return lake.publish(about.key, artefact, about, provenance)

    part = add("read_source", SourceFile(name="part.stl", content=b"solid"), {})
    views = add("sample_viewpoints", _viewpoints(), {"file": part.digest})
    entries = add("measure_samples", _measurability(), {"viewpoints": views.digest})
    for min_coverage in (0.9, 1.0):
        selection = add("select_views", _selection(min_coverage), {"m": entries.digest}, min_coverage=min_coverage)
    add("record_plan", plan(), {})
    lake.record_run("one", {"refs": [selection]})
    return lake


@pytest.mark.parametrize("sql", STATEMENTS, ids=[statement.split("\n")[0][:40] for statement in STATEMENTS])
def test_every_statement_of_the_documentation_has_an_answer(filled: Lake, sql: str) -> None:
    answer = filled.query(sql)
    assert answer.num_rows > 0
    assert not any(column.null_count for column in answer.columns)


def test_the_documentation_has_statements() -> None:
    assert len(STATEMENTS) >= 5


def test_the_busiest_candidates_are_those_that_numpy_counts(filled: Lake) -> None:
    sql = next(statement for statement in STATEMENTS if "worst_um" in statement)
    rows = filled.query(sql).to_pylist()
    assert [(row["view"], row["samples"], row["z_m"]) for row in rows] == [(1, 3, 1.5), (0, 1, 0.5)]
    assert rows[0]["worst_um"] == pytest.approx(30.0)


def test_what_was_made_from_a_file_is_its_whole_offspring(filled: Lake) -> None:
    sql = next(statement for statement in STATEMENTS if "RECURSIVE" in statement)
    stages = [row["stage"] for row in filled.query(sql).to_pylist()]
    assert stages == ["read_source", "sample_viewpoints", "measure_samples", "select_views", "select_views"]


def test_views_hold_every_artefact_of_a_kind_under_its_digest(lake: Lake) -> None:
    refs = [lake.publish(recipe(n=n).key, tally(*range(n)), recipe(n=n)) for n in range(3)]
    again = lake.publish(recipe(n=7).key, tally(0), recipe(n=7))  # a content that is there already
    assert again.digest == refs[1].digest
    rows = lake.query("SELECT digest, count FROM test_tally_counts ORDER BY ALL").to_pylist()
    expected = [(refs[1].digest, 0), (refs[2].digest, 0), (refs[2].digest, 1)]
    assert [(row["digest"], row["count"]) for row in rows] == sorted(expected)


@dataclass(frozen=True, eq=False, repr=False)
class _TallyWithNote(Artefact):
    KIND: ClassVar[str] = "test-tally-with-note"

    note: tuple[str, ...] = column("Words", dtype="str", table="counts")
    count: Any = column("Counts", dtype="int32", table="counts")


def test_artefacts_of_an_older_declaration_stand_in_the_same_view(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    lake.publish(recipe(n=1).key, tally(4), recipe(n=1))
    monkeypatch.setattr(_TallyWithNote, "KIND", "test-tally")
    lake.publish(recipe(n=2).key, _TallyWithNote(("new",), np.array([5], np.int32)), recipe(n=2))
    rows = lake.query("SELECT count, note FROM test_tally_counts ORDER BY count").to_pylist()
    assert rows == [{"count": 4, "note": None}, {"count": 5, "note": "new"}]


def test_data_that_no_manifest_commits_is_not_seen(lake: Lake) -> None:
    ref = lake.publish(recipe().key, tally(1), recipe())
    content = lake.place.read(f"data/test-tally/{ref.digest}/counts.parquet")
    lake.place.put("data/test-tally/" + "0" * 64, {"counts.parquet": content or b""})
    assert lake.query("SELECT * FROM test_tally_counts").num_rows == 1


def test_show_tables_lists_views_and_tables(filled: Lake) -> None:
    names = filled.query("SHOW TABLES")["name"].to_pylist()
    assert {"manifests", "inputs", "runs", "fields", "viewpoints_views", "view_selection_greedy"} <= set(names)
    assert not any(name.startswith("recording") for name in names)


def test_fields_tell_the_unit(filled: Lake) -> None:
    answer = filled.query("SELECT unit, frame, dtype FROM fields WHERE field = 'position_m'").to_pylist()
    assert answer == [{"unit": "m", "frame": "part", "dtype": "float64[3]"}]


def test_a_table_that_is_not_there_is_told_with_the_nearest_few(filled: Lake) -> None:
    with pytest.raises(InvalidInputError) as caught:
        filled.query("SELECT * FROM measurability_entry")
    said = str(caught.value)
    assert said.startswith("SQL: there is no table 'measurability_entry': did you mean measurability_entries")
    tables = filled.query("SHOW TABLES")["name"].to_pylist()
    assert len([name for name in tables if name in said]) <= 4 < len(tables)


@pytest.mark.parametrize(
    ("sql", "fact"),
    [
        ("SELEC 1", "syntax error"),
        ("SELECT * FROM nothing", "no table 'nothing'"),
        ("SELECT nothing FROM manifests", '"nothing" not found'),
        ("SELECT 'a'::INT", "Could not convert"),
    ],
)
def test_a_wrong_statement_is_told_with_the_tables_there_are(filled: Lake, sql: str, fact: str) -> None:
    with pytest.raises(InvalidInputError, match=fact) as caught:
        filled.query(sql)
    assert f'"SHOW TABLES" lists all {len(filled.query("SHOW TABLES"))} tables' in str(caught.value)


@pytest.mark.parametrize(
    "sql",
    [
        "COPY (SELECT 1) TO '{folder}/stolen.csv'",
        "COPY manifests TO '{file}' (FORMAT parquet)",
        "SELECT 1; COPY (SELECT 1) TO '{folder}/stolen.csv'",
        "EXPLAIN ANALYZE COPY (SELECT 1) TO '{folder}/stolen.csv'",
        "/* so */ EXPLAIN /* so */ ANALYZE COPY (SELECT 1) TO '{folder}/stolen.csv'",
        "EXPLAIN (ANALYZE) COPY (SELECT 1) TO '{folder}/stolen.csv'",
        "EXPORT DATABASE '{folder}/stolen'",
        "ATTACH '{folder}/stolen.db'",
        "CREATE TABLE a (i INT)",
        "SET enable_external_access = true",
        "INSTALL httpfs",
        "CALL pragma_version()",
        "COPY (PIVOT (SELECT 1 AS a) ON a USING sum(a)) TO '{folder}/stolen.csv'",
    ],
)
def test_a_statement_that_would_write_is_refused(filled: Lake, tmp_path: Path, sql: str) -> None:
    before = filled.place.walk("")
    file = filled.paths(filled.resolve("viewpoints"))["views.parquet"]
    with pytest.raises(InvalidInputError):
        filled.query(sql.format(folder=tmp_path, file=file))
    assert filled.place.walk("") == before
    assert not list(tmp_path.glob("stolen*"))
    assert filled.verify() == []


def test_a_refusal_names_what_may_be_written(filled: Lake) -> None:
    with pytest.raises(InvalidInputError, match=r"only read here, but this is .* COPY: write SELECT"):
        filled.query("COPY manifests TO 'x.csv'")


def test_files_outside_the_lake_are_not_read(filled: Lake, tmp_path: Path) -> None:
    (tmp_path / "secret.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InvalidInputError, match="Permission Error"):
        filled.query(f"SELECT * FROM read_csv('{tmp_path}/secret.csv')")


@pytest.mark.parametrize(
    "sql", ["EXPLAIN SELECT * FROM viewpoints_views", "EXPLAIN ANALYZE SELECT 1", "SUMMARIZE runs"]
)
def test_what_only_reads_is_answered(filled: Lake, sql: str) -> None:
    assert filled.query(sql).num_rows > 0


def test_a_missing_file_is_told(lake: Lake) -> None:
    ref = lake.publish(recipe().key, tally(1), recipe())
    lake.place.remove(f"data/test-tally/{ref.digest}/counts.parquet")
    with pytest.raises(LakeError, match="files cannot be read"):
        lake.query("SELECT * FROM test_tally_counts")


def test_an_empty_lake_answers(lake: Lake) -> None:
    assert lake.query("SELECT count(*) AS n FROM manifests").to_pylist() == [{"n": 0}]
    assert lake.query("SELECT * FROM inputs, runs, fields").num_rows == 0
    assert lake.query("").num_rows == 0


def test_a_folder_with_odd_letters_is_read(tmp_path: Path) -> None:
    lake = Lake(str(tmp_path / "it's a [lake] * of ü?"))
    lake.publish(recipe().key, tally(4), recipe())
    assert lake.query("SELECT count FROM test_tally_counts").to_pylist() == [{"count": 4}]


def _viewpoints() -> Viewpoints:
    return Viewpoints(
        sample=np.arange(2, dtype=np.int32),
        position_m=np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 1.5]]),
        quaternion=np.array([[1.0, 0, 0, 0]] * 2),
        delta_rot_rad=np.zeros(2),
        theta_tilt_rad=np.zeros(2),
        psi_tilt_rad=np.zeros(2),
        standoff_m=np.full(2, 0.182),
    )


def _measurability() -> Measurability:
    return Measurability(
        view=np.array([0, 1, 1, 1], np.int32),
        sample=np.array([0, 0, 1, 2], np.int32),
        uncertainty_m=np.array([1e-5, 1e-5, 2e-5, 3e-5], np.float32),
        start_m=np.zeros(2),
        end_m=np.ones(2),
        cause=np.zeros(3, np.int8),
    )


def _selection(share: float) -> ViewSelection:
    return ViewSelection(
        view=np.array([1], np.int32),
        n_samples=np.array([3], np.int32),
        n_only=np.array([2], np.int32),
        max_uncertainty_m=np.array([3e-5]),
        cause=np.zeros(3, np.int8),
        greedy_view=np.array([1], np.int32),
        method="greedy",
        lower_bound=share,
        gap=0.0,
        proven=True,
        stopped_by="optimality",
    )
