"""A quadruped of any size whose MJCF has nothing for looks: no colours, floor texture, sky or light."""

from __future__ import annotations

from pathlib import Path

import dappo_batch
from dappo_batch import ClassTable

LIMBS = {"front_left": (1, 1), "back_left": (-1, 1), "back_right": (-1, -1), "front_right": (1, -1)}


def quadruped(folder: Path, length: float, looks: str = "", floor: str = "") -> ClassTable:
    """Compile one whose trunk has a length, m; `looks` are elements of its MJCF, `floor` attributes."""
    leg = """
      <body name="{name}" pos="{x} {y} 0">
        <joint name="{name}" type="hinge" axis="0 1 0" range="-50 50"/>
        <geom name="{name}" type="capsule" fromto="0 0 0 0 0 {down}" size="{radius}"/>
      </body>"""
    legs = "".join(
        leg.format(
            name=name, x=0.45 * x * length, y=0.2 * y * length, down=-0.5 * length, radius=0.04 * length
        )
        for name, (x, y) in LIMBS.items()
    )
    motors = "".join(f'<motor joint="{name}" ctrlrange="-1 1"/>' for name in LIMBS)
    (folder / "quadruped.xml").write_text(
        f'<mujoco>{looks}<worldbody><geom name="floor" type="plane" size="0 0 1" {floor}/>'
        f'<body name="trunk" pos="0 0 {0.54 * length}"><freejoint/>'
        f'<geom name="trunk" type="box" size="{0.5 * length} {0.15 * length} {0.08 * length}"/>{legs}'
        f'<camera name="above" pos="0 0 {3 * length}"/></body></worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )
    limbs = "".join(f'[[limbs]]\nname = "{name}"\nbody = "{name}"\njoints = ["{name}"]\n' for name in LIMBS)
    (folder / "quadruped.toml").write_text(
        'name = "quadruped"\nmjcf = "quadruped.xml"\nmain_body = "trunk"\nframe_skip = 5\n'
        f"max_episode_steps = 100\naction_scale = 1.0\n{limbs}"
        '[damage]\ntypes = ["jammed_joint"]\nmax_damaged_limbs = 2\n'
        "[damage.jammed_joint]\njoint = 0\nrange_deg = 0.1\n"
        "[reset]\nqpos_noise = 0.0\nqvel_noise = 0.0\n"
        f"[termination]\nheight = [{0.01 * length}, {5 * length}]\n"
        '[observation]\nterms = [{ term = "qpos", skip = 2 }, { term = "qvel" }]\n'
        '[reward]\ndefault = "speed"\n[reward.speed]\nterms = [{ term = "forward_velocity", weight = 1.0 }]\n'
    )
    return dappo_batch.compile_class_table(folder / "quadruped.toml")
