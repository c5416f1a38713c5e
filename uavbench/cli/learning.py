"""``uavbench train`` and ``uavbench export``."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from uavbench.cli.shared import command, fail


def train(
    agent: Annotated[str, typer.Argument(help="A built-in agent that learns, or path.py with a class Learner.")],
    scenario: Annotated[str, typer.Option(help="An id, or the path of a .toml file.")] = "Manhattan32-CPP-v0",
    config: Annotated[
        str, typer.Option(help="One of the agent's own (ddqn: paper, fast, finish), or a .toml file that changes some values.")
    ] = "fast",
    seed: Annotated[int, typer.Option(min=0, max=2**24 - 1, help="The seed of all randomness in the training.")] = 0,
    start: Annotated[Path | None, typer.Option("--from", help="Weights to start from; by default none.")] = None,
    out: Annotated[Path, typer.Option(help="The folder for weights, checkpoints and curves.")] = Path("runs"),
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the last checkpoint.")] = False,
    threads: Annotated[int, typer.Option(min=1, help="The number of threads that compute the network.")] = 1,
    processes: Annotated[
        int,
        typer.Option(min=1, help="The number of processes that share the training (ppo). Another number gives other weights."),
    ] = 1,
    device: Annotated[
        Literal["auto", "cpu", "cuda", "mps"],
        typer.Option(help="Where the network computes; auto takes a graphics card if there is one."),
    ] = "auto",
) -> None:
    """Train a learned agent.

    Writes the weights that score best on validation episodes, a checkpoint every few minutes, and curves for TensorBoard.
    torchrun can start the processes of a training on several machines (docs/clusters.md).
    """
    from rich.console import Console

    from uavbench import UavbenchError, load_scenario
    from uavbench.agents.agent import find_agent
    from uavbench.cli.progress import training_progress
    from uavbench.learning.group import group_for
    from uavbench.learning.train import train as train_agent
    from uavbench.learning.training import Training, read_config

    try:
        group = group_for(processes)
        console = Console(quiet=group.rank > 0)
        source = find_agent(agent)
        training = Training(
            source, load_scenario(scenario), *read_config(source, config), seed, start, group.size if group else processes
        )
        with training_progress(console, f"{training.label} on {training.scenario.id}") as progress:
            kept = train_agent(
                training,
                out,
                resume=resume,
                threads=threads,
                device=device,
                on_start=progress.show,
                on_update=progress.advance,
                on_point=progress.add_point,
            )
        flies = [kept] if source.built_in else [agent, "--weights", kept]
        follow = command("evaluate", "--agent", *flies, "--scenario", scenario)
        console.print(f"next:  {follow}", highlight=False, markup=False, soft_wrap=True)
    except UavbenchError as error:
        raise fail(error) from None
    except OSError as error:
        raise fail(f"--out: cannot write {error.filename or out}: {error.strerror}") from None


def dataset(
    scenario: Annotated[str, typer.Argument(help="An id, or the path of a .toml file; for one UAV.")],
    agent: Annotated[str, typer.Option(help="The agent that flies: a built-in's name, or a file as for evaluate.")] = "planner",
    episodes: Annotated[int, typer.Option(min=1, help="How many episodes of the train split, from 0 on.")] = 100,
    out: Annotated[
        Path | None, typer.Option(help="Minari's folder of datasets; by default MINARI_DATASETS_PATH or ~/.minari/datasets.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="The dataset's id; by default uavbench/<scenario>/<agent>-v0.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="The number of processes.")] = 1,
) -> None:
    """Write an agent's flights on the train split as a dataset of Minari, for learning without flying.

    Needs the extra dataset: pip install 'uavbench[dataset]'.
    """
    from rich.console import Console

    from uavbench import UavbenchError, load_scenario
    from uavbench.agents.agent import find_agent
    from uavbench.cli.progress import episodes_progress
    from uavbench.evaluation.evaluate import Job
    from uavbench.integrations.minari import write_dataset

    try:
        job = Job(find_agent(agent), load_scenario(scenario), "train", None)
        with episodes_progress(Console(), f"{job.source.name} on {job.scenario.id}", "CRAL") as progress:
            place = write_dataset(
                job,
                episodes,
                out,
                name=name,
                workers=workers,
                on_start=lambda: progress.show(episodes),
                on_record=progress.note,
            )
    except UavbenchError as error:
        raise fail(error) from None
    except OSError as error:
        raise fail(f"--out: cannot write {error.filename or out}: {error.strerror}") from None
    typer.echo(f"wrote {place}")


def export(
    agent: Annotated[str, typer.Argument(help="A built-in agent with weights, or a .safetensors file.")],
    path: Annotated[Path, typer.Argument(help="The file to write, for example model.onnx.")],
    scenario: Annotated[
        str | None, typer.Option(help="The scenario whose observations it takes; by default the one it was trained on.")
    ] = None,
) -> None:
    """Write a learned agent as an ONNX model.

    The model can be scored without the agent's code: uavbench evaluate --agent model.onnx.
    """
    from uavbench import UavbenchError, load_scenario
    from uavbench.agents.agent import find_agent
    from uavbench.learning.export import export as export_agent

    try:
        source = find_agent(agent)
        loaded = load_scenario(scenario or source.trained_on, run_code=scenario is not None)
        export_agent(source, loaded, path)
    except (UavbenchError, ValueError) as error:
        raise fail(error) from None
    except OSError as error:
        raise fail(f"cannot write {path}: {error.strerror}") from None
    typer.echo(f"wrote {path}; next:  {command('evaluate', '--agent', path, '--scenario', scenario or loaded.id)}")
