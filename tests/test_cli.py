"""The command line itself: start-up, help, interruptions, consoles and pipes."""

import os
import subprocess
import sys
from dataclasses import replace

import pytest
from synthetic import make_frames, write_clips, write_sequence

from rtdenoise import __version__
from rtdenoise.cli import commands
from rtdenoise.cli import main as entry
from rtdenoise.cli.commands import parse
from rtdenoise.cli.denoise import told
from rtdenoise.cli.lists import split_names
from rtdenoise.cli.main import main
from rtdenoise.cli.progress import progress_bar
from rtdenoise.run.denoise import Summary

VERBS = ("denoise", "combine", "inspect", "render", "clips", "clean", "estimates", "train", "evaluate", "report",
         "view", "export", "demo")  # fmt: skip
RUN = "from rtdenoise.cli.main import main; import sys; main(sys.argv[1:])"


def process(*arguments, code=RUN, **options):
    """The command line in a process of its own."""
    return subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True,
                          timeout=120, **options)  # fmt: skip


def refused(capsys, *arguments):
    """The one line on stderr with which the command line exits with 2."""
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and error.startswith("rtdenoise: ") and error.count("\n") == 1, error
    return error


HEAVY = {"torch", "mitsuba", "matplotlib", "skimage", "pyoidn", "OpenEXR", "scipy", "PIL", "numpy"}
MAX_MODULES = 600  # that are imported for --help; 290 with Python 3.11
MAX_SECONDS = 2.0  # of CPU; 0.25 s on an idle machine


def test_help_starts_fast_and_imports_nothing_heavy():
    """The best of three runs: another process can make a run slower, but not faster."""
    code = ("import sys, time; start = time.process_time()\n"
            "from rtdenoise.cli.main import main\n"
            "try: main(['--help'])\n"
            "except SystemExit: pass\n"
            f"seconds = time.process_time() - start; print(seconds, len(sys.modules), {HEAVY} & set(sys.modules))"
            )  # fmt: skip
    runs = [process(code=code).stdout.splitlines()[-1].split(maxsplit=2) for _ in range(3)]
    _, modules, imported = runs[0]
    assert imported == "set()" and int(modules) < MAX_MODULES
    assert min(float(seconds) for seconds, *_ in runs) < MAX_SECONDS


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_command_names_its_values(verb, capsys):
    with pytest.raises(SystemExit) as stop:
        main([verb, "--help"])
    shown = capsys.readouterr().out
    assert stop.value.code == 0 and f"rtdenoise {verb}" in shown
    assert "[[" not in shown and "{None}" not in shown and "(default: )" not in shown


def test_no_folders_are_none(capsys):
    assert refused(capsys, "estimates") == "rtdenoise: no clips: name at least one folder of clips\n"


def test_estimates_say_how_to_train_on_them(tmp_path, capsys):
    write_clips(tmp_path, [0])
    main(["estimates", str(tmp_path), "--methods", "noisy,accumulate"])
    assert "--frames 5 --estimates noisy accumulate --data" in capsys.readouterr().out


def test_lists_without_a_name_are_one_line(tmp_path, capsys):
    clips, out = write_clips(tmp_path / "clips", [0]), tmp_path / "run"
    assert "--methods: name at least one" in refused(capsys, "estimates", clips, "--methods")
    assert "data: name at least one folder" in refused(capsys, "train", "--data", "--out", out)
    assert "--precision: name at least one" in refused(capsys, "evaluate", clips, "--out", out, "--precision")
    combiner = "train", "--data", clips, "--out", out, "--model", "combiner", "--frames", "5"
    assert "estimates: name at least one method" in refused(capsys, *combiner, "--estimates")
    assert not out.exists()


def test_version(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"rtdenoise {__version__}\n"


def test_lists_take_spaces_and_commas():
    evaluate = parse(["evaluate", "a", "b", "--out", "o", "--spp", "1,4", "8", "--methods", "noisy,svgf", "oidn"])
    assert [str(path) for path in evaluate.sources] == ["a", "b"] and evaluate.spp == (1, 4, 8)
    assert split_names(evaluate.methods) == ("noisy", "svgf", "oidn")


def test_settings_of_a_network_are_collected():
    given = ["--set", "widths=32,48", "--set", "longest=24"]
    config = parse(["train", "--data", "a", "b", "--out", "o", "--model", "default", *given]).config
    assert config.set == ("widths=32,48", "longest=24") and config.model == "default" and len(config.data) == 2


def test_near_names_are_suggested(tmp_path, capsys):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    assert "(did you mean 'default'?)" in refused(
        capsys, "denoise", shot, "--out", tmp_path / "o", "--model", "defualt"
    )
    line = refused(capsys, "evaluate", shot, "--out", tmp_path / "o", "--methods", "svfg")
    assert "unknown method 'svfg' (did you mean 'svgf'?)" in line
    assert "cycles" in refused(capsys, "inspect", shot, "--preset", "cycels")
    assert "no command 'denoyse' (did you mean 'denoise'?)" in refused(capsys, "denoyse", shot)


def test_missing_references_may_be_in_another_folder(tmp_path, capsys):
    shot = write_sequence(tmp_path / "shot", [replace(frame, reference=None) for frame in make_frames(2)])
    line = refused(capsys, "evaluate", shot, "--out", tmp_path / "o", "--methods", "noisy")
    assert "no layer 'reference'" in line and line.rstrip().endswith("--reference DIR")


def test_no_bar_before_an_error(tmp_path, capsys):
    refused(capsys, "denoise", tmp_path / "nowhere", "--out", tmp_path / "o")
    with pytest.raises(SystemExit):
        main(["denoise", str(tmp_path / "nowhere"), "--out", str(tmp_path / "o")])
    assert capsys.readouterr().out == ""
    with progress_bar("working") as bar:
        bar.update(bar.add_task("", total=None), completed=1, total=2)
    assert "working" in capsys.readouterr().out


def test_names_are_printed_as_they_are(capsys):
    with progress_bar("working") as bar:
        bar.console.print("shots/a [final] :cat: [/b]", soft_wrap=True)
    assert capsys.readouterr().out.startswith("shots/a [final] :cat: [/b]\n")


def test_the_summary_counts_the_frames_of_all_runs():
    left_out = {"warp of history": 1, "tiles": 0}
    lines = told(Summary(written=0, skipped=3, left_out=left_out, cuts=[7], gaps=[(4, 4), (8, 9)]))
    assert lines == ["0 frames written, 3 were there", "work saved: warp of history in 1 of 3 frames",
                     "cuts: history starts anew at frame 7",
                     "gaps: history starts anew after each; missing: 4, 8 to 9"]  # fmt: skip


def test_a_change_of_light_is_told_where_it_can_be_seen():
    lines = told(Summary(skipped=3, replaced={"albedo: above 2": 5}, exposure=[1.0, 1.01, 1.0]))
    assert lines[1:] == ["replaced: albedo: above 2 in 5 pixels of 3 frames"]
    (line,) = told(Summary(skipped=3, exposure=[1.0, 1.5, 1.51]))[1:]
    assert line == "exposure: all light changes in 1 of 3 frames, by a factor of up to 1.5, and history with it"


def test_interrupted_while_it_starts():
    """Ctrl-C while the commands are being imported: at this moment in any process, however fast the machine. Where the
    tests run in the background, their processes ignore it unless told not to."""
    code = ("import os, signal, sys\n"
            "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
            "class Interrupt:\n"
            "    def find_spec(self, name, path=None, target=None):\n"
            "        if name == 'tyro': os.kill(os.getpid(), signal.SIGINT)\n"
            f"sys.meta_path.insert(0, Interrupt())\n{RUN}")  # fmt: skip
    found = process("inspect", "x", code=code)
    assert found.returncode == 130 and found.stderr.startswith("rtdenoise: interrupted") and found.stdout == ""
    assert found.stderr.count("\n") == 1


def test_interrupted_inside_a_compiled_module(monkeypatch, capsys):
    def interrupted(arguments):
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr(commands, "parse", interrupted)
    with pytest.raises(SystemExit, match="130"):
        main(["inspect", "x"])
    assert capsys.readouterr().err.startswith("rtdenoise: interrupted")


@pytest.mark.parametrize("command", [["--help"], ["inspect", "SHOT"], ["--version"]])
def test_a_reader_that_has_gone_is_no_traceback(command, tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    reading, writing = os.pipe()
    os.close(reading)
    found = subprocess.run([sys.executable, "-c", RUN, *(str(shot) if a == "SHOT" else a for a in command)],
                           stdout=writing, stderr=subprocess.PIPE, text=True, timeout=120)  # fmt: skip
    os.close(writing)
    assert found.returncode == 141 and found.stderr == ""


@pytest.mark.parametrize("command", [["inspect", "SHOT"], ["denoise", "SHOT", "--out", "OUT", "--plan"], ["--help"]])
def test_a_console_that_knows_ascii_only(command, tmp_path):
    names = {"SHOT": write_sequence(tmp_path / "sh×t", make_frames(2)), "OUT": tmp_path / "öut"}
    found = process(*(names.get(a, a) for a in command), env=os.environ | {"PYTHONIOENCODING": "ascii"})
    assert found.returncode == 0 and found.stdout.isascii() and "Traceback" not in found.stderr, found.stderr


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 9.00 TiB"),
        RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory"),
    ],
)
def test_too_little_memory_is_one_line(error, monkeypatch, capsys):
    class Greedy:
        def run(self):
            raise error

    monkeypatch.setattr(commands, "parse", lambda arguments: Greedy())
    assert "out of memory" in (line := refused(capsys, "inspect", "x")) and "close other programs" in line


def test_other_errors_are_not_hidden(monkeypatch):
    class Broken:
        def run(self):
            raise RuntimeError("a defect")

    monkeypatch.setattr(commands, "parse", lambda arguments: Broken())
    with pytest.raises(RuntimeError, match="a defect"):
        entry.main(["inspect", "x"])


def test_an_unknown_choice_of_ops_is_one_line(tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(1))
    found = process("denoise", shot, "--out", tmp_path / "o", env=os.environ | {"RTDENOISE_OPS": "quick"})
    assert found.returncode == 2 and found.stderr.count("\n") == 1
    assert "RTDENOISE_OPS or ops.use: expected one of auto, plain, fused, got 'quick'" in found.stderr


def test_an_op_without_a_fused_path_is_one_line(tmp_path):
    """Those of a denoiser take no pictures in which gradients end, but training does."""
    clips = write_clips(tmp_path / "clips", [0])
    command = ("train", "--data", clips, "--out", tmp_path / "run", "--frames", "2", "--size", "16", "--steps", "1")
    found = process(*command, env=os.environ | {"RTDENOISE_OPS": "fused"})
    assert found.returncode == 2 and found.stderr.count("\n") == 1, found.stderr
    assert "no fused path" in found.stderr and "RTDENOISE_OPS=auto" in found.stderr
