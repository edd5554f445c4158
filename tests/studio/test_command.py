"""``warpriver studio`` with what cannot be: one line, exit code 2, and no server."""

import socket

import pytest

from warpriver.cli import main


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "99999"], "--port: '99999' is no port; give 0 to 65535"),
        (["--port", "high"], "is no port"),
        (["nowhere.tif"], "no file nowhere.tif"),
        (["line.exe"], "the studio opens scenes"),
        (["broken.csv"], "broken.csv"),
        (["broken.csv", "--folder", "session"], "holds a session already"),
        (["--host", "no.such.address.invalid"], "cannot listen on no.such.address.invalid"),
    ],
)
def test_what_cannot_be_is_refused(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "line.exe").write_text("x")
    (tmp_path / "broken.csv").write_text("x,y\n1,nonsense\n")
    (tmp_path / "session" / "run").mkdir(parents=True)
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(main(["studio", "--no-browser", *words]))
    told = capsys.readouterr().err.strip()
    assert ended.value.code == 2
    assert said in told and "Traceback" not in told and len(told.splitlines()[-1]) < 300


def test_a_port_that_is_taken_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        assert main(["studio", "--no-browser", "--port", str(other.getsockname()[1])]) == 2
    assert "cannot listen on 127.0.0.1" in capsys.readouterr().err
