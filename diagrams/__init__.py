"""What a user starts: the programs lie here."""

import sys
from pathlib import Path

from models import interrupts

# While the many modules of a program are loaded, Ctrl-C shall not end in a traceback of whichever one it met.
if Path(getattr(sys.modules["__main__"], "__file__", None) or "").resolve().parent == Path(__file__).resolve().parent:
    interrupts.begin()
