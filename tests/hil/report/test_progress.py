import io

from liftgate_hil.report.progress import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Gone(Terminal):
    def write(self, text):
        raise OSError(5, "gone")


def test_a_terminal_sees_one_line_rewritten():
    terminal = Terminal()
    progress = Progress(terminal, False)
    progress.update(9, 123.456, 0.25)
    progress.update(10, 1.0, 0.5)
    shown = terminal.getvalue()
    assert "\n" not in shown
    assert "iteration 10  loss 1.00000  step 0.500" in shown
    first, second = shown.split("\r")[1:]
    assert len(second) >= len(first.rstrip())
    progress.close()
    assert terminal.getvalue().split("\r")[-2].strip() == ""
    assert terminal.getvalue().endswith("\r")


def test_a_file_sees_nothing():
    stream = io.StringIO()
    with Progress(stream, False) as progress:
        progress.update(1, 1.0, 1.0)
    assert stream.getvalue() == ""


def test_quiet_is_quiet():
    terminal = Terminal()
    with Progress(terminal, True) as progress:
        progress.update(1, 1.0, 1.0)
    assert terminal.getvalue() == ""


def test_a_lost_terminal_does_not_end_the_computation():
    with Progress(Gone(), False) as progress:
        progress.update(1, 1.0, 1.0)
        progress.update(2, float("nan"), 1.0)
    with Progress(None, False) as progress:
        progress.update(1, 1.0, 1.0)
