"""``python -m dappo_batch``: the command line."""

from dappo_batch.cli import main

if __name__ == "__main__":
    main()
