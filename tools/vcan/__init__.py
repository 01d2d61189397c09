"""A machine with a real SocketCAN vcan0 to run a command on: `python -m tools.vcan -- COMMAND`."""
