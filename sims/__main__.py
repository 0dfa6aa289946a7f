"""`python -m parapod.sims` is the `parapod` command."""

import sys

from parapod.sims.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
