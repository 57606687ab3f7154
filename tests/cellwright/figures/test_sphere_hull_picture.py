"""Pictures of hulls show the body, the spheres and what the spheres miss; charts show a line a method."""

from __future__ import annotations

import numpy as np

from cellwright.cell.parametric_parts import box
from cellwright.figures.sphere_hull_picture import hull_picture, metrics_chart
from tests.cellwright.figures.test_charts import pixels, share

MESH = box((0.2, 0.1, 0.1))
RED, BLUE, GREEN = (209, 73, 91), (63, 167, 214), (42, 157, 92)


def reddish(png: bytes) -> float:
    rgb = pixels(png)
    return float(((rgb[..., 0] > 1.5 * rgb[..., 1]) & (rgb[..., 0] > 1.5 * rgb[..., 2])).mean())


def picture(radius: float) -> bytes:
    return hull_picture(
        MESH.vertices, MESH.faces, [("two", np.array([[0.05, 0, 0.05], [-0.05, 0, 0.05]]), np.full(2, radius))]
    )


def test_what_no_sphere_holds_is_red() -> None:
    assert reddish(picture(0.09)) == 0.0
    assert reddish(picture(0.07)) > 1e-3
    assert reddish(picture(0.05)) > reddish(picture(0.07))


def test_the_same_hull_gives_the_same_bytes_and_a_panel_each() -> None:
    assert picture(0.09) == picture(0.09)
    assert picture(0.09) != picture(0.1)
    hull = ("many", np.zeros((1, 3)), np.array([0.2]))
    one, five = (pixels(hull_picture(MESH.vertices, MESH.faces, [hull] * n)).shape for n in (1, 5))
    assert five[0] > one[0]
    assert five[1] > one[1]


def test_the_chart_draws_a_line_for_each_method() -> None:
    def rows(*lines: str) -> list[dict[str, object]]:
        names = ("protrusion_mean", "protrusion_p95", "protrusion_max", "gap_mean", "gap_max", "coverage")
        return [
            {"line": line, "n_spheres": n, "volume_ratio": 1 + place + 9 / n, **dict.fromkeys(names, 0.01 / n)}
            for place, line in enumerate(lines)
            for n in (5, 10, 20)
        ]

    one, two = metrics_chart(rows("ours")), metrics_chart(rows("ours", "k_means $"))
    assert share(one, BLUE, 12) > 1e-3
    assert share(one, GREEN, 12) == 0
    assert share(two, GREEN, 12) > 1e-3
    assert one == metrics_chart(rows("ours"))
