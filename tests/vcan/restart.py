"""Restart the reference ECU on vcan0, as a bench would switch its supply: restart.py PIDFILE"""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

pid = Path(sys.argv[1])
if pid.is_file():
    with contextlib.suppress(ProcessLookupError):
        os.kill(int(pid.read_text()), signal.SIGKILL)
command = [sys.executable, "-m", "liftgate_hil", "ecu", "--bus", "socketcan:vcan0", "--no-requests", "--quiet"]
ecu = subprocess.Popen(command, start_new_session=True)
pid.write_text(str(ecu.pid))
