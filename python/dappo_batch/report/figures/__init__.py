"""The figures of a report, each a function from data to a `Picture`.

They are drawn inside of `dappo_batch.report.picture.style`.
"""
