"""The stages: one a module. This table of contents is what flows import."""

from __future__ import annotations

from types import MappingProxyType

from schemas.stage import Stage
from tasks.assemble_cell import assemble_cell
from tasks.explain_samples import explain_samples
from tasks.extend_measurability import extend_measurability
from tasks.find_gaps import find_gaps
from tasks.find_overlaps import find_overlaps
from tasks.fit_spheres import fit_spheres
from tasks.follow_sweeps import follow_sweeps
from tasks.measure_coverage import measure_coverage
from tasks.measure_samples import measure_samples
from tasks.place_surroundings import place_surroundings
from tasks.preprocess_mesh import preprocess_mesh
from tasks.read_source import read_source
from tasks.record_plan import record_plan
from tasks.sample_surface import sample_surface
from tasks.sample_viewpoints import sample_viewpoints
from tasks.select_views import select_views
from tasks.simulate_scan import simulate_scan
from tasks.stitch_sweeps import stitch_sweeps
from tasks.trim_measurability import trim_measurability
from tasks.verify_plan import verify_plan
from tasks.write_report import write_report

_ALL: tuple[Stage, ...] = (
    read_source,
    assemble_cell,
    preprocess_mesh,
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
    verify_plan,
    simulate_scan,
    measure_coverage,
    record_plan,
    write_report,
    explain_samples,
    fit_spheres,
)

STAGES = MappingProxyType({stage.name: stage for stage in _ALL})
"""Every stage by its name, in the order of the chain."""

__all__ = [
    "STAGES",
    "assemble_cell",
    "explain_samples",
    "extend_measurability",
    "find_gaps",
    "find_overlaps",
    "fit_spheres",
    "follow_sweeps",
    "measure_coverage",
    "measure_samples",
    "place_surroundings",
    "preprocess_mesh",
    "read_source",
    "record_plan",
    "sample_surface",
    "sample_viewpoints",
    "select_views",
    "simulate_scan",
    "stitch_sweeps",
    "trim_measurability",
    "verify_plan",
    "write_report",
]
