"""Robots that several tests share: a tiny URDF writer, and the published robots from the shared data."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cellwright.arrays import FloatArray
from cellwright.cell.robot import Chain
from cellwright.cell.transforms import pose, rotation_from_rpy

SHARED = Path(__file__).parents[4] / "shared" / "data"


def shared(path: str) -> Path:
    found = SHARED / path
    if not found.exists():
        pytest.skip(f"{path} of the shared data is not there")
    return found


def random_chain(generator: np.random.Generator, n_joints: int = 6) -> Chain:
    """A chain of joints with random frames and axes."""
    turns = [rotation_from_rpy(*row) for row in generator.uniform(-math.pi, math.pi, (n_joints + 1, 3))]
    poses = pose(generator.uniform(-0.5, 0.5, (n_joints + 1, 3)), np.array(turns))
    axis = generator.normal(size=(n_joints, 3))
    ones = np.ones(n_joints)
    return Chain(poses[:-1], axis / np.linalg.norm(axis, axis=1, keepdims=True), poses[-1], -ones, ones, ones, ones)


def urdf_of(chain: Chain) -> str:
    """Write a chain as a URDF whose numbers carry all their digits."""
    links = "".join(f'<link name="l{k}"/>' for k in range(chain.n_joints + 1)) + '<link name="flange"/>'
    joints = "".join(
        f'<joint name="j{k + 1}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'{_origin(chain.T_parent_joint[k])}<axis xyz="{_text(chain.axis[k])}"/>'
        f'<limit lower="{chain.lower[k]}" upper="{chain.upper[k]}" velocity="1" effort="1"/></joint>'
        for k in range(chain.n_joints)
    )
    end = (
        f'<joint name="end" type="fixed"><parent link="l{chain.n_joints}"/><child link="flange"/>'
        f"{_origin(chain.T_last_flange)}</joint>"
    )
    return f'<robot name="random">{links}{joints}{end}</robot>'


def _origin(T: FloatArray) -> str:
    R = T[:3, :3]
    rpy = (math.atan2(R[2, 1], R[2, 2]), math.asin(-R[2, 0]), math.atan2(R[1, 0], R[0, 0]))
    return f'<origin xyz="{_text(T[:3, 3])}" rpy="{_text(np.array(rpy))}"/>'


def _text(values: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)


def chain_of_facts(name: str) -> Chain:
    """The kinematics of a robot of the shared facts, without its limits."""
    facts = yaml.safe_load(shared(f"robots/facts/{name}.yaml").read_text())["kinematics"]

    def at(origin: dict[str, list[float]]) -> FloatArray:
        return pose(np.array(origin["xyz"], float), rotation_from_rpy(*origin["rpy"]))

    fixed = np.array([at(joint["origin"]) for joint in facts["joints"]])
    axis = np.array([joint["axis"] for joint in facts["joints"]], float)
    ones = np.ones(len(axis))
    return Chain(fixed, axis, at(facts["tool0"]), -math.pi * ones, math.pi * ones, ones, ones)


def published_crx() -> tuple[str, Path]:
    """The manufacturer's CRX-10iA/L description with its few xacro expressions written out, and its folder."""
    text = shared("robots/crx10ia_l/crx10ia_l_urdf_macro.xacro").read_text()
    names: dict[str, Any] = {"radians": math.radians, "prefix": "", "parent": "", "child": "", "__builtins__": {}}

    def value(expression: str) -> str:
        return str(eval(expression, names))

    for name, expression in re.findall(r'<xacro:property name="(\w+)" value="([^"]*)"', text):
        names[name] = float(value(expression.removeprefix("${").removesuffix("}")))
    body = re.sub(r"\$\{(.*?)\}", lambda found: value(found[1]), text)
    body = re.sub(r"-(-[\d.]+)", lambda found: found[1][1:], body)
    body = re.sub(
        r"<xacro:property[^>]*/>|</?xacro:macro.*?>|</?xacro:if.*?>|</?xacro:insert_block.*?/>", "", body, flags=re.S
    )
    body = re.sub(r'<joint name="(base|child)_joint".*?</joint>', "", body, flags=re.S)
    return body.replace('xmlns:xacro="http://wiki.ros.org/xacro"', 'name="crx10ia_l"'), SHARED / "robots/crx10ia_l"
