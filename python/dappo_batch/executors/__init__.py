"""Executors for clusters: `concurrent.futures.Executor` over Ray and Slurm, for `dappo_batch.sweep`."""
