"""``python -m tests.gpu``: whether a machine's GPU computes what it should, and how fast.

It needs the extra ``gpu`` and no network. Phases that no longer fit into the time are skipped and named.
"""
