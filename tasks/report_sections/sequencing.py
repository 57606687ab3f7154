"""The section of the inspection report on the sequence: what the greedy, the stitched and the sequenced plan take."""

from __future__ import annotations

import base64
import math
from importlib import resources

from schemas.sequencing import SweepSequence


def sequencing_template() -> str:
    """Return the text of the section's template."""
    return resources.files("tasks").joinpath("templates/sequencing_section.html.j2").read_text("utf-8")


def sequencing_section(found: SweepSequence) -> str:
    """Return the section as HTML."""
    import jinja2

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(sequencing_template()).render(
        lead=_lead(found),
        with_dynamics=bool(all(math.isfinite(work) for work in found.work_j.tolist())),
        plans=_plan_rows(found),
        picture=base64.b64encode(found.picture).decode(),
    )


def _lead(found: SweepSequence) -> str:
    by = "time" if found.cost_kind == "time" else "the cost of optimal control (time, torque and speed, weighed)"
    if not found.is_taken:
        return f"The sweeps were to be sequenced by {by}. The stitched plan stays: {found.reason}."
    joined = ""
    if found.cost_kind != "time":
        joined = f" {found.n_joined} motions join sweeps without a stop, {found.n_stopped} stop at both ends."
    before = ""
    if math.isfinite(found.greedy_before_s):
        now = found.time_s[-1]
        before = (
            f" In the cell file's placement the greedy plan takes {found.greedy_before_s:.2f} s: new placement "
            f"and new sequence make that {100.0 * (now / found.greedy_before_s - 1.0):+.1f}%."
        )
    return f"The sweeps are sequenced by {by}.{joined} {found.reason[:1].upper()}{found.reason[1:]}.{before}"


def _plan_rows(found: SweepSequence) -> list[dict[str, str]]:
    return [
        {
            "plan": name,
            "duration": f"{found.duration_s[row]:.2f} s",
            "effort": f"{found.effort_n2m2s[row]:,.0f}",
            "work": f"{found.work_j[row]:,.0f} J",
            "torque": f"{found.torque_share[row]:.0%}",
            "cost": f"{found.cost[row]:.3f}",
            "taken": "this plan" if found.taken[row] else "",
        }
        for row, name in enumerate(found.plan)
    ]
