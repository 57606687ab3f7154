"""One digest a stage: what its version gives on a small fixed input.

The inputs leave no choice to the last bits of a float, and floats that a mathematics library may end differently on
another processor are rounded before they are digested: see `rounded`.
"""

from __future__ import annotations

import dataclasses
from hashlib import sha256
from typing import Any

import numpy as np

from schemas.artefact import Artefact, digest
from schemas.stage import Stage

GOLDENS: dict[str, tuple[int, str]] = {
    "read_source": (1, "b6ae33fa167a3b3e1d236d4de7eabfd49dade7647210686ada40e53002bc5dbe"),
    "assemble_cell": (3, "eb492a9c68096112e6fd92eee16c6cf5e7082d96015f64c720d00cc3730abf3c"),
    "preprocess_mesh": (2, "c1f63ceb86a44e3f3b5ee4224b5465c094b5c90f5930b53a32955ecb42da9ce0"),
    "place_surroundings": (1, "ff9b20ad74e406faf73484ef06ae1245db0e7416f753757c364659244f22daae"),
    "find_overlaps": (2, "66ddc44b8f9d88a32a40539c544df3b3c7f88020c180fc8a2f4533d2118e5503"),
    "sample_surface": (1, "2a78be2e07f5febdf513ab7005998f8ccb5f05d3cfc4ce6771c012ee16ca00ea"),
    "sample_viewpoints": (1, "2ce67e79b1d033c459492d85ed0dfbc394fb0bbf6c118272faf86846dfeb4484"),
    "measure_samples": (1, "8225f919363f6fb94f573b44c6c32cabb81422368ff18fd14817fac53cc4f546"),
    "follow_sweeps": (2, "161b2d9874c73b41d8188ff307b372ce80733d3848eb83bae544725c42e2d8eb"),
    "trim_measurability": (1, "fc34e9f4df8fab27c944ffcace9b24856ae69ddec68165345195628859f7aa89"),
    "select_views": (2, "4c2cf1d5df1a1439790c88244df8efeaa7ad8db9c12313039818f83cf2189e04"),
    "find_gaps": (1, "2027ec9675312584a728e186abefda5d4b70e1d889360852214219231cb95165"),
    "extend_measurability": (1, "67139771e575fea954d00004cda067721e53b0f8367dbd9e4dee6c18f57bdece"),
    "stitch_sweeps": (4, "dc5e036ea268f3eb3a852e35e18a1a115ac2a59b829f9b88975de6ab1dbaa861"),
    "optimise_placement": (3, "c892df2520f5914d7c5a0efa0cecbf2c85e47753ffaa06eeb4606857df7eb45b"),
    "compare_placements": (2, "1604e8ca6ae24ebd3f11033b66c0bef043b9659d8984abb2b7ac35f233b867b9"),
    "sequence_sweeps": (4, "8a902f62039571ac949f805d29d828627f7b504e0b74eb55a8c957bc2a20ec90"),
    "take_sequence": (1, "9cda7014362140b1488ba1824d2626c37f66badbb5ecf049d9b44fb0cad26a2a"),
    "verify_plan": (3, "55546930fdd6f1ef5f2e8cd4e60e9c2acd03f9897fc396596d95d5225c5eb4ff"),
    "simulate_scan": (1, "ae0ef57aa99e642122dd986c0044839e3e8721f849dc29db919c2b29980ee165"),
    "measure_coverage": (2, "4c032b182440c593ac9519cf0e5dfc0dc4639c60e9ad47a1f0a1f31457b9330b"),
    "record_plan": (2, "4d70977dc305d3e5af857df5780ff2bd3b69ddb9cb8eee789af156d9e619b375"),
    "write_report": (8, "7c8b1fbc4a3c26b51b4af9efac0b19a1267a230ef7db533c0041cffb56b92d01"),
    "explain_samples": (1, "03db89b69d6b66c6d1c7115f4e6aa7b39e3f8c429a4a4724f08cb1da535fb759"),
    "fit_spheres": (2, "1c76809ebe46896e8ef7889b1eaf6a66c007cca02f3c55ce9d48eaf4f3ea419d"),
    "spherize_robot": (2, "bdfd9594f9e8661cdd752f46f7251f0cce9030540870e954a58725c2e381eeae"),
    "cover_bodies": (2, "807ba37c31f386b87494d5eb9b06211ae3db072f3b12ae5f762c76ec082a7707"),
    "optimise_layout": (4, "11b7f44eb0efda01429b65ffd80b52c4483cf3f6d30fb0b55c90fa284fa2be93"),
    "record_layout": (2, "e89dbffb98b4d5d5659c7abe11fbf0ac579953673ac8538c1b3a9e35cc9d7f7c"),
    "write_layout_report": (3, "19c69dbb0bc83b2f767db062de94cb2852a7912045b4d2abc204d9c495e5e0a5"),
    "list_tasks": (2, "b0896b35e94f03abce0cf5974d1b227e76ac2aa031a9be98404024f724f6f94f"),
    "generate_alternatives": (2, "a4280896394f8b254424f9d34100d54d16a00fb34abb05d2c73230b7762c52e7"),
    "sequence_tasks": (6, "b051329021f97d4f639581e06c372ca4c2eb589007b15ccec99894f85d332781"),
    "verify_sequence": (3, "d6ef1b63eebc4cbe880bffa5ebfeee146751569f6937772da642b259b1d2d2aa"),
    "record_sequence": (1, "1b53252b5e9fffd9a9cba073901e9ab524ed582f8ae167ce28f85785e227ab99"),
    "write_sequence_report": (6, "04ef0e96024f87edc21c5f721db20c9883daec5ac3dab64f66c5b285a585b9b9"),
}
"""Version and digest of every stage, of the artefacts together where a stage is tried on several inputs."""


def check_golden(stage: Stage, *found: Artefact | str) -> None:
    """Fail if the stage gives something else (artefacts, or their text) than its version did when it was stored."""
    version, golden = GOLDENS[stage.name]
    single = [sha256(one.encode()).hexdigest() if isinstance(one, str) else digest(one) for one in found]
    together = single[0] if len(single) == 1 else sha256("".join(single).encode()).hexdigest()
    assert version == stage.version, f"{stage.name} has version {stage.version}: store its digest {together}"
    assert together == golden, f"the result changed to {together}: raise the version of {stage.name}"


def rounded(artefact: Any, digits: int = 9, **changes: Any) -> Any:
    """Return the artefact with all its arrays of doubles rounded (without negative zeros), and with some changes."""
    doubles = {
        field.name: np.round(value, digits) + 0.0
        for field in dataclasses.fields(artefact)
        if isinstance(value := getattr(artefact, field.name), np.ndarray) and value.dtype == np.float64
    }
    return dataclasses.replace(artefact, **(doubles | changes))
