"""ONNX models: the same scores as the network they are of, and clear words about models that do not fit."""

import numpy as np
import pytest
from typer.testing import CliRunner

from uavbench import load_scenario
from uavbench.agent import AgentLoadError, find_agent
from uavbench.cli import app
from uavbench.evaluate import AgentError, Job, evaluate
from uavbench.weights import save_weights

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
    from uavbench.observation import Observer

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
    model = tmp_path / "model.onnx"
    assert CliRunner().invoke(app, ["export", str(weights), str(model)]).exit_code == 0
    assert find_agent(str(model)).trained_on == CPP.id
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


def test_a_model_in_several_files_is_refused(tmp_path):
    """A digest of one of them would not tell which model it was."""
    made = onnx.load(model_of(tmp_path / "model.onnx", {"budget": (1,)}, width=6))
    onnx.save(made, tmp_path / "model.onnx", save_as_external_data=True, location="data.bin", size_threshold=0)
    assert (tmp_path / "data.bin").exists()
    with pytest.raises(AgentError, match=r"model\.onnx: not a model that ONNX Runtime takes"):
        fly(tmp_path / "model.onnx")


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
        ([str(weights), str(tmp_path / "m.onnx"), "--scenario", "Manhattan32-CPP-v0"], "another map"),
        ([str(weights), str(weights / "m.onnx")], "cannot write"),
    ):
        found = CliRunner().invoke(app, ["export", *words])
        assert found.exit_code == 2
        assert reason in found.output.replace("\n", " ")
    assert not list(tmp_path.glob("m.*"))
