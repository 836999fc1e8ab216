"""Exit status, help of each command, and signals."""

import io
import os
import signal
import time

import pytest

from aoabench.cli import main as main_module
from aoabench.cli.main import cli, dispatch, main
from aoabench.errors import RunError, UserError
from aoabench.store import compare as compare_module

COMMANDS = ["run", "locate", "list", "compare", "plot", "export", "collect", "replay", "reproduce", "report", "new", "test"]  # fmt: skip
JSON = ["run", "list", "compare", "export", "collect", "reproduce", "report", "test"]


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"], ["help"]])
def test_the_commands_are_listed_in_the_order_of_their_use(words, call):
    status, out, err = call(*words)
    assert (status, err) == (0, "")
    listed = out.partition("Commands:")[2].splitlines()[1:]
    assert [line.split()[0] for line in listed] == COMMANDS
    assert not any(line.endswith("...") for line in listed), "each line is whole"


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_has_help_with_an_example(name, call):
    status, out, err = call(name, "--help")
    assert (status, err) == (0, "")
    assert f"aoabench {name}" in out.partition("Example")[2]
    assert "--quiet" in out
    assert ("--json" in out) == (name in JSON)
    assert ("With --json:" in out) == (name in JSON)
    assert out == call(name, "-h")[1] == call("help", name)[1]
    for parameter in cli.commands[name].params:
        assert parameter.help, parameter


@pytest.mark.parametrize("flag", ["--version", "-V"])
def test_version(flag, call):
    import aoabench

    assert call(flag) == (0, f"aoabench {aoabench.__version__}\n", "")


@pytest.mark.parametrize(("words", "line"), [
    (["rnu"], "unknown command 'rnu'; did you mean 'run'? see `aoabench --help`"),
    (["xyzzy"], "unknown command 'xyzzy'; allowed: run, locate, list, compare, plot, export, "
     "collect, replay, reproduce, report, new, test; see `aoabench --help`"),
    (["--hlep"], "unknown option --hlep; did you mean '--help'? see `aoabench --help`"),
    (["--json", "list"], "unknown option --json before the command; allowed: after the command; see `aoabench --help`"),
    (["run", "--noise=vmf"], "run: unknown option --noise; did you mean 'noise=...'? see `aoabench run --help`"),
    (["run", "--wrst", "3"], "run: unknown option --wrst; did you mean '--worst'? see `aoabench run --help`"),
    (["run", "--worst"], "run: --worst needs a value; see `aoabench run --help`"),
    (["run", "-c", "jobs"], "run: --cfg: 'jobs' is not allowed; did you mean 'job'? see `aoabench run --help`"),
    (["compare"], "compare: RUN is missing: folder of a run (its runner.out); see `aoabench compare --help`"),
    (["replay", "x", "--replication", "1"],
     "replay: --estimator is missing: name of the estimator; see `aoabench replay --help`"),
    (["replay", "x", "--replication", "1.5"],
     "replay: --replication: '1.5' is not a valid integer; see `aoabench replay --help`"),
    (["collect", "a", "b"], "collect: unexpected argument (b); see `aoabench collect --help`"),
    (["list", "filtre"], "'filtre': no such group or preset; did you mean 'filter'?"),
])  # fmt: skip
def test_a_mistake_in_the_words_is_one_line(words, line, call):
    assert call(*words) == (2, "", f"aoabench: {line}\n")


@pytest.mark.parametrize(("error", "status", "line"), [
    (UserError("one\n  line"), 2, "aoabench: one line\n"),
    (RunError("no space"), 1, "aoabench: no space\n"),
    (KeyboardInterrupt(), 130,
     "aoabench: interrupted; finished parts are kept, the same command continues from them\n"),
])  # fmt: skip
def test_exit_status(error, status, line, call, monkeypatch):
    def fail(*_arguments):
        raise error

    monkeypatch.setattr(compare_module, "compare", fail)
    assert call("compare", "x") == (status, "", line)


@pytest.mark.parametrize("error", [EOFError("torn"), ValueError("a fault")])
def test_other_exceptions_are_a_line_and_not_hidden(error, call, monkeypatch, tmp_path):
    def fail(*_arguments):
        raise error

    monkeypatch.setattr(compare_module, "compare", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    status, out, err = call("compare", "x")
    assert (status, out, len(err.splitlines())) == (1, "", 1)
    assert err.startswith(f"aoabench: {type(error).__name__}: {error}; this is a fault ")
    monkeypatch.setenv("AOABENCH_DEBUG", "1")
    with pytest.raises(type(error), match=str(error)):
        main(["compare", "x"])


@pytest.fixture
def usual_handlers():
    """The usual handlers of signals, which tests under nohup lack; a stopped command ignores all."""
    usual = {signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL, signal.SIGINT: signal.default_int_handler}  # fmt: skip
    before = {one: signal.signal(one, handler) for one, handler in usual.items()}
    yield usual
    for one, handler in before.items():
        signal.signal(one, handler)


@pytest.mark.parametrize(("name", "status", "word"), [
    ("SIGTERM", 143, "terminated"), ("SIGHUP", 129, "hung up"), ("SIGINT", 130, "interrupted"),
])  # fmt: skip
def test_signals_end_a_command_as_ctrl_c_does(
    name, status, word, call, monkeypatch, usual_handlers
):
    number, ended = getattr(signal, name), []

    def slow(*_arguments):
        try:
            os.kill(os.getpid(), number)
            time.sleep(10)
        finally:  # further signals do not disturb the end
            os.kill(os.getpid(), number)
            os.kill(os.getpid(), signal.SIGTERM)
            ended.append(True)

    monkeypatch.setattr(compare_module, "compare", slow)
    code, out, err = call("compare", "x")
    assert (code, out) == (status, "")
    assert err.startswith(f"aoabench: {word}; ")
    assert len(err.splitlines()) == 1
    assert ended
    assert signal.getsignal(number) == signal.SIG_IGN, "until the process has ended"


def test_a_signal_that_is_lost_can_be_sent_again(call, monkeypatch, usual_handlers):
    """As one that arrives in a callback whose exceptions nobody sees."""
    monkeypatch.setattr(main_module, "_GRACE_S", 0)

    def slow(*_arguments):
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            os.kill(os.getpid(), signal.SIGINT)
        raise RunError("it was lost")

    monkeypatch.setattr(compare_module, "compare", slow)
    assert call("compare", "x")[0] == 130


def test_handlers_are_put_back_after_a_command_that_no_signal_ended(call, usual_handlers):
    assert call("list", "runner")[0] == 0
    assert {number: signal.getsignal(number) for number in usual_handlers} == usual_handlers


def test_an_ignored_signal_stays_ignored(call, monkeypatch):
    """As nohup wants it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:

        def hung_up(*_arguments):
            os.kill(os.getpid(), signal.SIGHUP)
            raise RunError("the end")

        monkeypatch.setattr(compare_module, "compare", hung_up)
        assert call("compare", "x") == (1, "", "aoabench: the end\n")
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_terminal_that_is_gone_changes_no_status(monkeypatch):
    class Gone:
        def write(self, _text):
            raise OSError(5, "Input/output error")

        def flush(self):
            pass

    monkeypatch.setattr(main_module.sys, "stderr", Gone())
    with pytest.raises(SystemExit) as stop:
        main(["rnu"])
    assert stop.value.code == 2


def test_an_output_that_knows_ascii_only(tmp_path, monkeypatch):
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise" / "mine.yaml").write_text("# 3° ± 1°\n", encoding="utf-8")
    written = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(written, encoding="ascii"))
    with pytest.raises(SystemExit) as stop:
        main(["list", "noise", "--config-dir", str(tmp_path)])
    assert stop.value.code == 0
    main_module.sys.stdout.flush()
    assert rb"3\xb0 \xb1 1\xb0" in written.getvalue()


def test_dispatch_returns_the_status_and_raises_user_errors(capsys):
    assert dispatch(["list", "runner"]) == 0
    assert "local" in capsys.readouterr().out
    with pytest.raises(UserError, match="unknown command"):
        dispatch(["rnu"])
