"""Warp kernels around the physics of mujoco_warp: damage, reset, observation, reward and the policy.

The package needs the extra ``gpu``. It receives robots as tables of numbers and never imports
``dappo_batch``.
"""
