"""A whole small plan, made by hand: an arm with two joints sweeps twice over a plate that has a table beside it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from cellwright.causes import Cause
from cellwright.cell.bodies import BASE, WORLD, Body, Box, Sphere
from cellwright.cell.transforms import pose
from schemas.motion import ScanCloud, Trajectory, Verification
from schemas.overlaps import StandingOverlaps
from schemas.part import SurfaceSamples
from schemas.sources import CellModel
from schemas.views import Coverage, Measurability, Reachability, Viewpoints, ViewSelection
from tests.tasks.plate_scene import points_on_top, scanned, selected, views_down
from tests.tasks.test_simulate_scan import cell_model, swing

T_WORLD_PART = pose(np.array([0.5, 0.1, 0.2]), np.eye(3))
TIP = pose(np.array([0.1, 0.0, 0.0]), np.eye(3))

BODIES = (
    Body("base_link", Box((0.1, 0.1, 0.1)), BASE, np.eye(4)),
    Body("one.1", Box((0.5, 0.02, 0.02)), 1, np.eye(4)),
    Body("tool0", Sphere(0.01), 2, np.eye(4)),
    Body("camera", Box((0.02, 0.03, 0.04)), 2, TIP),
    Body("table", Box((1.0, 1.0, 0.1)), WORLD, pose(np.array([0.0, 0.0, -0.05]), np.eye(3))),
)
POINTS = ((0.0, 0.0), (0.05, 0.0), (0.1, 0.0), (-0.05, 0.0), (-0.1, 0.0), (0.0, 0.15))


def cell() -> CellModel:
    return cell_model(*BODIES)


def trajectory() -> Trajectory:
    """Two sweeps of half a second after two connections; views 4 and 1 in this order."""
    coarse = swing("connection", "sweep", "connection", "sweep")
    time = np.linspace(0.0, 2.0, 21)
    segment = np.minimum(time // 0.5, 3).astype(np.int32)
    since = time - coarse.start_s[segment]
    return changed(
        coarse,
        time_s=time,
        position_rad=np.outer(time, [0.2, -0.2]),
        velocity_rad_s=np.tile([0.2, -0.2], (21, 1)),
        acceleration_rad_s2=np.zeros((21, 2)),
        segment=segment,
        travel_m=np.where(segment % 2 == 1, 0.2 * since - 0.05, np.nan),
        view=np.array([-1, 4, -1, 1], np.int32),
    )


def changed(artefact: Any, **changes: Any) -> Any:
    return dataclasses.replace(artefact, **changes)


def cloud() -> SurfaceSamples:
    return points_on_top(*POINTS)


def coverage() -> Coverage:
    cause = np.array([0, 0, 0, 0, Cause.COLLISION, Cause.NOT_SCANNED], np.int8)
    return Coverage(
        measured=cause == 0,
        coverable=cause != Cause.COLLISION,
        cause=cause,
        blocked_by=np.array([-1, -1, -1, -1, 0, -1], np.int32),
        uncertainty_m=np.where(cause == 0, 45e-6, np.nan).astype(np.float32),
        body=("table", "part"),
        radius_m=0.002,
        share_measured=4 / 6,
        share_of_coverable=4 / 5,
    )


def viewpoints() -> Viewpoints:
    return views_down(*POINTS)


def selection() -> ViewSelection:
    return changed(selected(1, 4, n_samples=6), max_uncertainty_m=np.array([5e-5, np.nan]))


def measurability() -> Measurability:
    """View 1 measures the even samples, view 4 the odd ones, both the first."""
    return Measurability(
        view=np.array([1, 1, 1, 4, 4, 4, 4], np.int32),
        sample=np.array([0, 2, 4, 0, 1, 3, 5], np.int32),
        uncertainty_m=np.full(7, 5e-5, np.float32),
        start_m=np.zeros(6),
        end_m=np.zeros(6),
        cause=np.zeros(6, np.int8),
    )


def scan() -> ScanCloud:
    """Six points, one profile each, in disorder."""
    points = np.array([(x, y, 0.0) for x, y in POINTS])
    return changed(
        scanned(points),
        profile=np.array([5, 0, 3, 1, 4, 2], np.int32),
        time_s=np.array([0.61, 0.62, 0.9, 1.61, 1.7, 1.999]),
        position_m=np.tile([0.0, 0.0, 0.182], (6, 1)),
        quaternion=np.tile([0.0, 1.0, 0.0, 0.0], (6, 1)),
        segment=np.array([1, 1, 1, 3, 3, 3], np.int32),
    )


def overlaps() -> StandingOverlaps:
    return StandingOverlaps(
        body=("part",),
        other=("table",),
        depth_m=np.array([0.0121]),
        finding=("part and table stand in one another, by at least 12.1 mm: move one of them or correct its size",),
        supported_by=("table",),
        tipping=(),
        note=(),
        n_pairs=3,
        resting_m=0.001,
        support_margin_m=0.05,
        overhang_m=0.0,
        engine="FCL",
    )


def reachability(n_unsettled: int = 0) -> Reachability:
    return Reachability(
        view=np.zeros(0, np.int32),
        branch=np.zeros(0, np.int8),
        start_m=np.zeros(0),
        end_m=np.zeros(0),
        q_start_rad=np.zeros((0, 2)),
        outcome=np.zeros(len(POINTS), np.int8),
        blocked_by=np.full(len(POINTS), -1, np.int32),
        body=("table", "part"),
        n_unsettled=n_unsettled,
    )


def verification() -> Verification:
    return Verification(
        check=("joint speed", "distance of bodies"),
        found=np.array([0.98, 0.0043]),
        permitted=np.array([1.0, 0.0]),
        unit=("of the limit", "m"),
        at_least=np.array([False, True]),
        least_distance_m=0.00432,
        proven_distance_m=0.0043,
        nearest_bodies=("one.1", "part"),
        nearest_s=1.25,
        n_distances=12,
        n_states=4321,
        engine="FCL",
    )
