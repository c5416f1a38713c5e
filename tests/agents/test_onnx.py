"""ONNX models: the same scores as the network they are of, and clear words about models that do not fit."""

import shlex

import numpy as np
import pytest
from typer.testing import CliRunner

from uavbench import load_scenario
from uavbench.agents.agent import AgentLoadError, find_agent
from uavbench.agents.onnx_file import OnnxFileError, has_external_data, metadata
from uavbench.agents.weights import save_weights
from uavbench.cli.app import app
from uavbench.evaluation.evaluate import AgentError, Job, evaluate

torch = pytest.importorskip("torch", reason="exporting needs PyTorch: pip install 'uavbench[ddqn]'")
onnx = pytest.importorskip("onnx", reason="needs ONNX: pip install 'uavbench[onnx]'")
pytest.importorskip("onnxruntime", reason="needs ONNX Runtime: pip install 'uavbench[onnx]'")
pytest.importorskip("onnxscript", reason="needs onnxscript: pip install 'uavbench[onnx]'")

CPP = load_scenario("Block8-CPP-v0")


def fly(agent, scenario=CPP):
    return {r.episode: r for r in evaluate(Job(find_agent(str(agent)), scenario, "test"), range(30))}


@pytest.fixture
def weights(tmp_path):
    """Weights of an untrained network."""
    from uavbench.simulation.observation import Observer

    torch.manual_seed(0)
    network = find_agent("ddqn").module().Network(Observer(CPP))
    arrays = {name: tensor.contiguous().numpy() for name, tensor in network.state_dict().items()}
    path = tmp_path / "some.safetensors"
    save_weights(path, {**arrays, "budget_scale": np.array([0.1])}, {"agent": "ddqn", "scenario": CPP.id})
    return path


def test_a_model_acts_as_the_network_it_is_of(weights, tmp_path):
    model = tmp_path / "model.onnx"
    found = CliRunner().invoke(app, ["export", str(weights), str(model), "--scenario", CPP.id])
    assert found.exit_code == 0, found.output
    torch_records, onnx_records = fly(weights), fly(model)
    assert len({tuple(r.actions.reshape(-1)) for r in torch_records.values()}) > 5
    for number, record in torch_records.items():
        assert np.array_equal(record.actions, onnx_records[number].actions)


def test_a_model_says_on_what_it_was_trained(weights, tmp_path):
    model = tmp_path / "my model.onnx"
    found = CliRunner().invoke(app, ["export", str(weights), str(model)])
    assert found.exit_code == 0
    words = ["uavbench", "evaluate", "--agent", str(model), "--scenario", CPP.id]
    assert shlex.split(found.output.split("next:")[1]) == words
    assert find_agent(str(model)).trained_on == CPP.id
    said = {each.key.removeprefix("uavbench."): each.value for each in onnx.load(model).metadata_props}
    assert said.items() >= {"mission": "coverage", "layers": "4", "local_size": "9", "global_scale": "3"}.items()
    with pytest.raises(AgentError, match="another mission than that of Block8-DH-v0"):
        fly(model, load_scenario("Block8-DH-v0"))
    told = CliRunner().invoke(app, ["export", str(model), str(tmp_path / "again.onnx")])
    assert (told.exit_code, "is an ONNX model already" in told.output) == (2, True), told.output


def model_of(path, inputs, width=6, batch="batch", factor=1.0):
    """Write a model that sums up its inputs."""
    from onnx import TensorProto, helper, numpy_helper

    nodes, sums = [], []
    axes = helper.make_tensor("axes", TensorProto.INT64, [1], [-1])
    for name in inputs:
        nodes.append(helper.make_node("Flatten", [name], [f"{name}_flat"], axis=1))
        nodes.append(helper.make_node("ReduceSum", [f"{name}_flat", "axes"], [f"{name}_sum"], keepdims=1))
        sums.append(f"{name}_sum")
    nodes.append(helper.make_node("Sum", sums, ["total"]))
    nodes.append(helper.make_node("MatMul", ["total", "weights"], ["values"]))
    weights = numpy_helper.from_array(factor * np.arange(width, dtype=np.float32)[None], "weights")
    graph = helper.make_graph(
        nodes,
        "sums",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch, *shape]) for name, shape in inputs.items()],
        [helper.make_tensor_value_info("values", TensorProto.FLOAT, [batch, width])],
        [axes, weights],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    made.ir_version = 9
    onnx.save(made, path)
    return path


def test_models_may_take_part_of_the_observation_or_one_at_a_time(tmp_path):
    for batch in ("batch", 1):
        records = fly(model_of(tmp_path / "model.onnx", {"budget": (1,)}, batch=batch))
        assert all((record.actions == 5).all() for record in records.values())  # the highest is the last: land
        assert all(record.landed for record in records.values())


@pytest.mark.parametrize(
    ("inputs", "width", "reason"),
    [
        ({"map": (1,)}, 6, "input 'map' is none of local, global, budget"),
        ({"budget": (2,)}, 6, "input budget is"),
        ({"budget": (1,)}, 5, "its output has shape"),
    ],
)
def test_what_does_not_fit_is_said(inputs, width, reason, tmp_path):
    with pytest.raises(AgentError, match=reason):
        fly(model_of(tmp_path / "model.onnx", inputs, width))


@pytest.mark.parametrize("batch", [4, 0])
def test_a_batch_that_is_neither_any_nor_one_is_refused(batch, tmp_path):
    with pytest.raises(AgentError, match=r"model\.onnx: input budget: its batch is"):
        fly(model_of(tmp_path / "model.onnx", {"budget": (1,)}, batch=batch))


def test_sizes_that_a_model_leaves_open_are_taken(tmp_path):
    records = fly(model_of(tmp_path / "model.onnx", {"local": (4, "h", "w"), "budget": (1,)}))
    assert all(record.landed for record in records.values())


def test_values_that_are_no_numbers_are_refused(tmp_path):
    with pytest.raises(AgentError, match=r"model\.onnx: its values are not finite"):
        fly(model_of(tmp_path / "model.onnx", {"budget": (1,)}, factor=float("nan")))


def in_branch(made):
    """Put a model's nodes and weights into both branches of a condition."""
    from onnx import TensorProto, helper, numpy_helper

    graph, result = made.graph, [helper.make_tensor_value_info("chosen", TensorProto.FLOAT, ["batch", 6])]
    body = helper.make_graph(list(graph.node), "body", [], list(graph.output), list(graph.initializer))
    chosen = helper.make_node("If", ["always"], ["chosen"], then_branch=body, else_branch=body)
    always = numpy_helper.from_array(np.array(True), "always")
    outer = helper.make_graph([chosen], "outer", list(graph.input), result, [always])
    return helper.make_model(outer, opset_imports=made.opset_import, ir_version=9)


def as_constants(made):
    """Turn a model's weights into nodes."""
    from onnx import helper

    nodes = [helper.make_node("Constant", [], [each.name], value=each) for each in made.graph.initializer]
    graph = helper.make_graph([*nodes, *made.graph.node], "constants", list(made.graph.input), list(made.graph.output))
    return helper.make_model(graph, opset_imports=made.opset_import, ir_version=9)


@pytest.mark.parametrize("change", [lambda made: made, in_branch, as_constants])
@pytest.mark.parametrize("beside", [True, False])
def test_weights_in_other_files_are_refused_wherever_these_are(change, beside, tmp_path, monkeypatch):
    """The digest is of the model's file alone, so weights beside it or in the current folder could be anybody's."""
    made = change(onnx.load(model_of(tmp_path / "model.onnx", {"budget": (1,)})))
    onnx.save(made, tmp_path / "model.onnx")
    whole = fly(tmp_path / "model.onnx")
    assert all((record.actions == 5).all() for record in whole.values())
    monkeypatch.chdir(tmp_path)
    folder = tmp_path if beside else tmp_path / "models"
    folder.mkdir(exist_ok=True)
    model = folder / "model.onnx"
    onnx.save(made, model, save_as_external_data=True, location="data.bin", size_threshold=0, convert_attribute=True)
    (folder / "data.bin").replace(tmp_path / "data.bin")
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: pytest.fail("a session was made"))
    with pytest.raises(AgentError, match=r"model\.onnx: some of its weights are in other files.* save it as one file"):
        fly(model)
    told = CliRunner().invoke(app, ["evaluate", "--agent", str(model), "--scenario", CPP.id, "--episodes", "1"])
    assert (told.exit_code, "Traceback" in told.output) == (1, False), told.output


def test_what_a_model_says_of_itself_is_read_as_onnx_reads_it(tmp_path):
    made = onnx.load(model_of(tmp_path / "model.onnx", {"budget": (1,)}))
    for name, value in (("uavbench.world.scenario", "Mine-CPP-v0"), ("ä", "é" * 300), ("empty", "")):
        made.metadata_props.add(key=name, value=value)
    content = made.SerializeToString()
    assert metadata(content) == {"uavbench.world.scenario": "Mine-CPP-v0", "ä": "é" * 300, "empty": ""}
    assert not has_external_data(content)
    for cut in range(1, len(content)):
        try:
            onnx.load_model_from_string(content[:cut])
        except Exception:
            with pytest.raises(OnnxFileError):
                has_external_data(content[:cut])
        else:
            has_external_data(content[:cut])


def test_files_that_are_no_models(tmp_path):
    with pytest.raises(AgentLoadError, match="there is no such file"):
        find_agent(str(tmp_path / "model.onnx"))
    (tmp_path / "model.onnx").write_bytes(b"no model")
    with pytest.raises(AgentError, match=r"model\.onnx: not a model"):
        fly(tmp_path / "model.onnx")


def test_export_says_what_it_cannot_do(weights, tmp_path):
    for words, reason in (
        (["greedy", str(tmp_path / "m.onnx")], "greedy has no network"),
        ([str(weights), str(tmp_path / "m.pt"), "--scenario", CPP.id], r"ends in .onnx"),
        ([str(weights), str(tmp_path / "m.onnx"), "--scenario", "Manhattan32-CPP-v0"], "have local_size 9, not 17"),
        ([str(weights), str(weights / "m.onnx")], "cannot write"),
    ):
        found = CliRunner().invoke(app, ["export", *words])
        assert found.exit_code == 2
        assert reason in found.output.replace("\n", " ")
    assert not list(tmp_path.glob("m.*"))
