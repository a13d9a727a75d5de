"""Odd inputs for everything that takes input: files, configurations, command lines and arguments.

``python -m tests.properties.fuzz --minutes 60`` tries as many as it can in worker processes; the tests next
to this folder try some of each kind. Whatever is put in, the answer must be a result or an error of the tree
under ``DappoError``, and of the command line one of its exit codes: no panic, no abort, no foreign exception,
and an end within a time limit.
"""
