"""Runner of a command on a machine with a real SocketCAN vcan0: `python -m tools.vcan -- COMMAND`."""
