"""``uavbench train`` and ``uavbench export``."""

from pathlib import Path
from typing import Annotated

import typer

from uavbench.commands.shared import fail


def train(
    agent: Annotated[str, typer.Argument(help="A built-in that learns, or path.py with a Learner.")],
    scenario: Annotated[str, typer.Option(help="An id, or the path of a .toml file.")] = "Manhattan32-CPP-v0",
    config: Annotated[
        str, typer.Option(help="One of the agent's own (ddqn: paper, fast), or a .toml file of what differs.")
    ] = "fast",
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another training.")] = 0,
    out: Annotated[Path, typer.Option(help="Where weights, checkpoints and curves go.")] = Path("runs"),
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint.")] = False,
    threads: Annotated[int, typer.Option(min=1, help="Of the network's arithmetic.")] = 1,
) -> None:
    """Train a learned agent.

    Writes the weights that score best on validation episodes, a checkpoint every few minutes, and curves for TensorBoard.
    """
    from rich.console import Console

    from uavbench import ScenarioError, load_scenario
    from uavbench.agent import AgentLoadError, find_agent
    from uavbench.display import training_progress
    from uavbench.train import TrainError, Training, read_config
    from uavbench.train import train as train_agent
    from uavbench.weights import WeightsError

    console = Console()
    try:
        source = find_agent(agent)
        training = Training(source, load_scenario(scenario), *read_config(source, config), seed)
        with training_progress(console, f"{training.label} on {training.scenario.id}") as progress:
            kept = train_agent(
                training,
                out,
                resume=resume,
                threads=threads,
                on_start=progress.show,
                on_update=progress.advance,
                on_point=progress.add_point,
            )
        console.print(f"next:  uavbench evaluate --agent {kept} --scenario {scenario}", highlight=False, soft_wrap=True)
    except (AgentLoadError, ScenarioError, TrainError, WeightsError) as error:
        raise fail(error) from None
    except KeyboardInterrupt:
        raise fail(f"interrupted; the checkpoint is in {out}, and --resume goes on", 1) from None


def export(
    agent: Annotated[str, typer.Argument(help="A built-in that has learned, or a .safetensors file.")],
    path: Annotated[Path, typer.Argument(help="The model to write, model.onnx.")],
    scenario: Annotated[str, typer.Option(help="Whose observations it is to take.")] = "Manhattan32-CPP-v0",
) -> None:
    """Write a learned agent as an ONNX model.

    It can be scored without the agent's code: --agent model.onnx.
    """
    from uavbench import ScenarioError, load_scenario
    from uavbench.agent import AgentLoadError, find_agent
    from uavbench.export import ExportError
    from uavbench.export import export as export_agent

    try:
        export_agent(find_agent(agent), load_scenario(scenario), path)
    except (AgentLoadError, ScenarioError, ExportError, ValueError) as error:
        raise fail(error) from None
    typer.echo(f"wrote {path}; next:  uavbench evaluate --agent {path} --scenario {scenario}")
