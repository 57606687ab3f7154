"""The section of the inspection report on sphere hulls: the part inside its spheres, and how well every hull fits."""

from __future__ import annotations

import base64
from importlib import resources

import numpy as np

from schemas.part import PartMesh
from schemas.sphere_hull import SphereHull


def hull_template() -> str:
    """Return the text of the section's template."""
    return resources.files("tasks").joinpath("templates/hull_section.html.j2").read_text("utf-8")


def hull_section(mesh: PartMesh, part: SphereHull | None, cell: SphereHull | None) -> str:
    """Return the section as HTML, empty without hulls."""
    import jinja2

    from cellwright.figures.sphere_hull_picture import hull_picture

    hulls = [hull for hull in (part, cell) if hull is not None]
    if not hulls:
        return ""
    picture = b""
    if part is not None:
        shown = (f"{len(part.radius_m)} spheres", part.centre_m, part.radius_m)
        picture = hull_picture(mesh.vertices_m, mesh.faces, [shown])
    there = np.concatenate([hull.n_spheres > 0 for hull in hulls])
    proven = np.concatenate([hull.surface_covered for hull in hulls])[there]
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(hull_template()).render(
        picture=base64.b64encode(picture).decode(),
        rows=[row for hull in hulls for row in _rows(hull)],
        n_bodies=str(int(there.sum())),
        n_proven=str(int(proven.sum())),
        n_spheres=str(sum(len(hull.radius_m) for hull in hulls)),
        left_out=[name for hull in hulls for name, count in zip(hull.body, hull.n_spheres.tolist()) if count == 0],
    )


def _rows(hull: SphereHull) -> list[dict[str, str]]:
    found = []
    for row in np.flatnonzero(hull.trial_chosen).tolist():
        body = int(hull.trial_body[row])
        lengths = (hull.protrusion_mean_m, hull.protrusion_p95_m, hull.protrusion_max_m, hull.overshoot_max_m)
        found.append(
            {
                "body": hull.body[body],
                "n_spheres": str(int(hull.trial_n_spheres[row])),
                "proven": "100 %" if hull.surface_covered[body] else f"no ({hull.coverage[row]:.2%} sampled)",
                "ratio": f"{hull.volume_ratio[row]:.2f}",
                "lengths": " / ".join(f"{1e3 * length[row]:.1f}" for length in lengths),
            }
        )
    return found
