import time

from crashrate.runs import progress


def test_latest_text_is_said_again_while_none_comes(monkeypatch, capsys):
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.02)
    with progress.now_and_then() as say:
        say("one")
        say("two")
        deadline = time.monotonic() + 5
        said = ""
        while said.count("two (") < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
            said += capsys.readouterr().err
    assert said.startswith("one\n")
    assert said.count("two (0 s)") >= 2


def test_nothing_is_said_where_there_is_nothing(monkeypatch, capsys):
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.01)
    with progress.now_and_then():
        time.sleep(0.05)
    assert capsys.readouterr().err == ""
