"""The command line: `kato3d arrange`, `reconstruct`, `view`, `runs`, `benchmark` and `doctor`."""

import os
import re
import signal
import sys
import webbrowser
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import Any

from pipeline.errors import STOPPED, in_one_sentence
from pipeline.naming import did_you_mean

_DESCRIPTION = (
    "Prepare photographs, turn them into textured meshes and look at runs; `make run` trains the models (README.md)."
)


def main(words: Sequence[str] | None = None) -> None:
    """Run a command; an error of the user is one sentence, without a traceback, and exits with status 1."""
    if sys.stderr is None:  # after `2>&-`; progress is written there
        sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115
    if isinstance(sys.stdout, TextIOWrapper):  # which it is not after `>&-`
        sys.stdout.reconfigure(errors="backslashreplace")  # any file's name can be printed
    with in_one_sentence(), _ended_by_signals():
        arguments, unknown = _parser().parse_known_args(words)
        if unknown:
            options = re.findall(r"--[\w-]+", arguments.parser.format_usage())
            arguments.parser.error(f"'{unknown[0]}' is not understood{did_you_mean(unknown[0], options)}")
        arguments.command(arguments)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the program as Ctrl-C does, with what is half written removed."""

    def end(number: int, _: FrameType | None) -> None:
        sys.stderr.write(STOPPED)
        sys.exit(128 + number)

    # One that is ignored stays so: that is what nohup does.
    ending = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
    for number in ending:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ending:
            signal.signal(number, signal.SIG_DFL)


def _parser() -> ArgumentParser:
    parser = ArgumentParser("kato3d", description=_DESCRIPTION)
    add = partial(_add_command, parser.add_subparsers(required=True, metavar="COMMAND"))
    project = ArgumentParser(add_help=False)
    project.add_argument(
        "--project", type=Path, default=Path(), help="the project's folder, with params.yaml; default: the current one"
    )
    _add_reconstruct(add, project)
    _add_arrange(add)
    view = add("view", "open the page of a run", project)
    view.add_argument("--run", help="default: the first run in params.yaml")
    view.set_defaults(command=_view)
    runs = add("runs", "write one table of all runs' figures", project)
    runs.set_defaults(command=_runs)
    _add_benchmark(add, project)
    doctor = add("doctor", "say what is installed and found, and what is missing", project)
    doctor.set_defaults(command=_doctor)
    return parser


def _add_command(commands: Any, name: str, what: str, *parents: ArgumentParser) -> ArgumentParser:
    """Add a command that says what it does in the list of commands and in its own help."""
    parser = commands.add_parser(name, parents=parents, help=what, description=f"{what[0].upper()}{what[1:]}.")
    parser.set_defaults(parser=parser)
    return parser


def _add_reconstruct(add: Callable[..., ArgumentParser], project: ArgumentParser) -> None:
    reconstruct = add("reconstruct", "turn photographs into textured meshes, with a trained model", project)
    reconstruct.add_argument(
        "photographs",
        type=Path,
        nargs="+",
        metavar="PHOTO",
        help="a photograph, or a folder: at least as large as the model's pictures; -NAME is written ./-NAME",
    )
    model = reconstruct.add_mutually_exclusive_group()
    model.add_argument("--run", help="whose model; default: the first run in params.yaml")
    model.add_argument(
        "--pretrained",
        metavar="NAME",
        help="an entry of `pretrained` in params.yaml instead, such as `car`, which comes with the code",
    )
    reconstruct.add_argument("--out", type=Path, required=True, help="folder to write to")
    reconstruct.add_argument(
        "--outputs",
        type=_outputs,
        default="mesh,picture,turntable,pose",
        help="what to write: some of mesh,picture,turntable,video,pose, with commas between; default: %(default)s",
    )
    reconstruct.add_argument(
        "--fine-tune",
        action="store_true",
        help="fit background, pose and shape to each; takes seconds a photograph on a CPU",
    )
    reconstruct.add_argument(
        "--paint",
        action="store_true",
        help="paint each mesh with its photograph (`paint` in params.yaml); best after --fine-tune",
    )
    reconstruct.set_defaults(command=_reconstruct)


def _add_arrange(add: Callable[..., ArgumentParser]) -> None:
    arrange = add("arrange", "bring a folder of photographs into the form to learn from")
    arrange.add_argument("folder", type=Path, metavar="FOLDER", help="photographs of one category, at any depth")
    arrange.add_argument("--category", required=True, help="what they show, such as ship")
    arrange.add_argument("--out", type=Path, required=True, help="new folder to write, the SOURCE of make run")
    arrange.add_argument(
        "--least-side",
        type=_positive,
        default=32,
        metavar="PIXELS",
        help="photographs whose short side is below it are left out; default: %(default)s",
    )
    arrange.set_defaults(command=_arrange)


def _add_benchmark(add: Callable[..., ArgumentParser], project: ArgumentParser) -> None:
    benchmark = add("benchmark", "measure another method's predictions as a run is measured", project)
    benchmark.add_argument(
        "predictions", type=Path, metavar="PREDICTIONS", help="an .npz file; docs/benchmark.md says what it holds"
    )
    benchmark.add_argument("--category", required=True, help="of which pictures they are, such as car")
    benchmark.add_argument("--dataset", default="toybox", help="to which these belong; default: %(default)s")
    benchmark.add_argument("--out", type=Path, required=True, help="file of the figures to write, such as car.json")
    benchmark.set_defaults(command=_benchmark)


# Commands import what they need, after what needs no more of it to be refused: PyTorch alone takes seconds.


def _reconstruct(arguments: Namespace) -> None:
    from pipeline.cli.photographs import list_tasks, passed_over
    from pipeline.cli.runs import find_pretrained, find_run

    project, out = arguments.project, arguments.out
    pretrained = arguments.pretrained
    trained = find_run(project, arguments.run) if pretrained is None else find_pretrained(project, pretrained)
    tasks = list_tasks(arguments.photographs, out)
    for folder in filter(Path.is_dir, arguments.photographs):
        _print_passed_over(passed_over(folder, [*(task.photograph for task in tasks), *out.rglob("*")]))
    print(f"with {trained.title}")

    from pipeline.cli.reconstruct import Steps, reconstruct
    from pipeline.config import scalar
    from pipeline.device import resolve_device

    device = resolve_device(scalar(trained.params, "device"))
    steps = Steps(arguments.fine_tune, arguments.paint)
    outcome = reconstruct(tasks, trained, out, arguments.outputs, steps, device)
    print(f"{outcome.written} written to {out}, {outcome.skipped} already there, {len(outcome.failures)} failed")
    if outcome.page:
        print(f"open {outcome.page.resolve()}")
    elif outcome.written or outcome.skipped:
        print("no page: it needs `mesh`, `picture` and `pose` among --outputs")
    if outcome.failures:
        sys.exit("\n".join(f"error: {failure}" for failure in outcome.failures))


def _arrange(arguments: Namespace) -> None:
    from pipeline.cli.arrange import FEW, arrange

    found = arrange(arguments.folder, arguments.category, arguments.out, arguments.least_side)
    for reason in found.left_out:
        print(f"left out: {reason}")
    _print_passed_over(found.passed_over)
    left_out = len(found.left_out)
    print(f"{found.train} for training and {found.test} for testing written to {arguments.out}, {left_out} left out")
    if found.train < FEW:
        print(f"fewer than {FEW} for training were not tried; 2,000 are good (docs/your-own-photos.md)")


def _print_passed_over(counts: Mapping[str, int]) -> None:
    from pipeline.datasets.folder import ENDINGS

    for ending, count in sorted(counts.items()):
        made = " that `kato3d reconstruct` has written" if ending in ENDINGS else ""
        print(f"passed over: {count} with the ending '{ending}'{made}")


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"'{text}' is no number of pixels; expected a whole number from 1")
    return int(text)


def _outputs(text: str) -> list[str]:
    from pipeline.cli.photographs import FILES

    outputs = [output.strip() for output in text.split(",")]
    unknown = [output for output in outputs if output not in FILES]
    if unknown:
        raise ArgumentTypeError(f"'{unknown[0]}' is no output; expected some of {','.join(FILES)}")
    return outputs


def _view(arguments: Namespace) -> None:
    from pipeline.cli.runs import find_run

    page = find_run(arguments.project, arguments.run).page.resolve()
    webbrowser.open(page.as_uri())
    print(f"open {page}")  # where no browser is, or none on this screen


def _runs(arguments: Namespace) -> None:
    from pipeline.cli.measured_runs import measured_runs, runs_page
    from pipeline.export.runs_page import write_runs_page

    page = runs_page(arguments.project)
    write_runs_page(page, measured_runs(arguments.project))
    print(f"open {page.resolve()}")


def _benchmark(arguments: Namespace) -> None:
    from pipeline.cli.benchmark import benchmark
    from pipeline.evaluation.tables import format_figures

    predictions, project, out = arguments.predictions, arguments.project, arguments.out
    print(format_figures(benchmark(predictions, project, arguments.dataset, arguments.category, out)))
    print(f"written to {out}")


def _doctor(arguments: Namespace) -> None:
    from pipeline.cli.doctor import findings

    complete = True
    for found, what, advice in findings(arguments.project):
        print(f"{'ok     ' if found else 'MISSING'} {what}" + (f": {advice}" if advice else ""))
        complete &= found
    if not complete:
        sys.exit(1)


if __name__ == "__main__":
    main()
