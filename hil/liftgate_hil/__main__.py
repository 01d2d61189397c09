"""`python -m liftgate_hil`."""

import sys

from liftgate_hil.cli.main import main

sys.exit(main())
