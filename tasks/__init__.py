"""The stages: one a module. This table of contents is what flows import."""

from __future__ import annotations

from types import MappingProxyType

from schemas.stage import Stage
from tasks.assemble_cell import assemble_cell
from tasks.compare_placements import compare_placements
from tasks.cover_bodies import cover_bodies
from tasks.explain_samples import explain_samples
from tasks.extend_measurability import extend_measurability
from tasks.find_gaps import find_gaps
from tasks.find_overlaps import find_overlaps
from tasks.fit_spheres import fit_spheres
from tasks.follow_sweeps import follow_sweeps
from tasks.generate_alternatives import generate_alternatives
from tasks.list_tasks import list_tasks
from tasks.measure_coverage import measure_coverage
from tasks.measure_samples import measure_samples
from tasks.optimise_layout import optimise_layout
from tasks.optimise_placement import optimise_placement
from tasks.place_surroundings import place_surroundings
from tasks.preprocess_mesh import preprocess_mesh
from tasks.read_source import read_source
from tasks.record_layout import record_layout
from tasks.record_plan import record_plan
from tasks.record_sequence import record_sequence
from tasks.sample_surface import sample_surface
from tasks.sample_viewpoints import sample_viewpoints
from tasks.select_views import select_views
from tasks.sequence_sweeps import sequence_sweeps
from tasks.sequence_tasks import sequence_tasks
from tasks.simulate_scan import simulate_scan
from tasks.spherize_robot import spherize_robot
from tasks.stitch_sweeps import stitch_sweeps
from tasks.take_sequence import take_sequence
from tasks.trim_measurability import trim_measurability
from tasks.verify_plan import verify_plan
from tasks.verify_sequence import verify_sequence
from tasks.write_layout_report import write_layout_report
from tasks.write_report import write_report
from tasks.write_sequence_report import write_sequence_report

_ALL: tuple[Stage, ...] = (
    read_source,
    assemble_cell,
    preprocess_mesh,
    fit_spheres,
    place_surroundings,
    find_overlaps,
    sample_surface,
    sample_viewpoints,
    measure_samples,
    follow_sweeps,
    trim_measurability,
    select_views,
    find_gaps,
    extend_measurability,
    stitch_sweeps,
    optimise_placement,
    compare_placements,
    sequence_sweeps,
    take_sequence,
    verify_plan,
    simulate_scan,
    measure_coverage,
    record_plan,
    write_report,
    explain_samples,
    spherize_robot,
    cover_bodies,
    optimise_layout,
    record_layout,
    write_layout_report,
    list_tasks,
    generate_alternatives,
    sequence_tasks,
    verify_sequence,
    record_sequence,
    write_sequence_report,
)

STAGES = MappingProxyType({stage.name: stage for stage in _ALL})
"""Every stage by its name, in the order of the chain."""

__all__ = [
    "STAGES",
    "assemble_cell",
    "compare_placements",
    "cover_bodies",
    "explain_samples",
    "extend_measurability",
    "find_gaps",
    "find_overlaps",
    "fit_spheres",
    "follow_sweeps",
    "generate_alternatives",
    "list_tasks",
    "measure_coverage",
    "measure_samples",
    "optimise_layout",
    "optimise_placement",
    "place_surroundings",
    "preprocess_mesh",
    "read_source",
    "record_layout",
    "record_plan",
    "record_sequence",
    "sample_surface",
    "sample_viewpoints",
    "select_views",
    "sequence_sweeps",
    "sequence_tasks",
    "simulate_scan",
    "spherize_robot",
    "stitch_sweeps",
    "take_sequence",
    "trim_measurability",
    "verify_plan",
    "verify_sequence",
    "write_layout_report",
    "write_report",
    "write_sequence_report",
]
