"""Composed jobs equal Hydra's own composition, in values, types, choices and errors."""

import copy
import math

import hydra
import pytest
from omegaconf import OmegaConf, open_dict

from aoabench.config import build, compose
from aoabench.config.compose import compose_cells
from aoabench.config.composer import Composer
from aoabench.config.messages import NotComposed
from aoabench.config.nodes import Resolver, hydra_initialised, resolved
from aoabench.config.overrides import read
from tests.scenarios.test_heard import Deaf

OWN = {
    "experiment/mine.yaml": """# @package _global_
defaults:
  - override /filter: [mine, ekf_vmf]
  - override /noise: ae_flip
filter: {ekf_vmf: {engine: numpy}}
reps: 7
seed: ${reps}
hydra: {sweeper: {params: {noise.sigma_deg: "3,4"}}}
""",
    "experiment/open.yaml": """# @package _global_
reps: 7
hydra: {sweeper: {params: {seed: "1,${reps}"}}}
""",
    "filter/mine.yaml": """mine:
  _target_: aoabench.filters.kalman.EKF
  measurement: {_target_: aoabench.models.unit_vector.UnitVector, kappa: 20}
""",
    "noise/mine.yaml": "defaults: [vmf, _self_]\nsigma_deg: 1_0\nname: yes\n",
}

EKF = "filter=[ekf_vmf]"
JOBS = [
    [],
    [EKF, "noise.sigma_deg=3", "seed=4"],
    [
        "noise.sigma_deg=1e1",
        "noise.kappa=null",
        "scenario.name='007'",
        "scenario.side_m=5.0",
        "seed=5",
        "seed=6",
        "noise.a=1_000",
        "noise.b=on",
        "noise.c='on'",
        "noise.d=0x1F",
        "noise.e=.5",
        "noise.f=''",
    ],
    ["scenario.anchors.position_m=[[1,2,3],[4,5,6.0]]", "noise.g=[]", "noise.h={}"],
    ["noise={_target_: x}", "until={metric: nees}", "scenario.anchors={facing: [[1,0,0]]}"],
    [EKF, "+filter={ekf_vmf: {engine: numpy}}", "filter.ekf_vmf.measurement.kappa=3"],
    [EKF, "+filter.ekf_vmf.measurement={kappa: 4}", "~filter.ekf_vmf.measurement._target_"],
    ["~until", "+until={metric: null}", "~store.steps", "~noise._target_"],
    ["++a.b.c=1", "+d=2", "+e={f: 3}", "++a.b.g=[4]"],
    ["until=3", "store=null", "runner.out=7"],
    ["seed=1", "reps=${seed}", "noise.sigma_deg=${reps}", "scenario.name=x${seed}y"],
    ["noise.sigma_deg='\\${seed}'", "noise.kappa=???"],
    ["filter=[ukf_ae_adaptive]", "noise=ae_flip", "noise.sigma_deg=5"],
    ["filter=[ukf_ae_adaptive]", "++filter.ukf_ae_adaptive.measurement.noise.sigma_deg=6"],
    ["filter=[ukf_ae_adaptive]", "filter.ukf_ae_adaptive.measurement.noise=${scenario}"],
    ["experiment=nurminen2018_fig4", "filter.pf_vmf.particles=9", "noise.sigma_deg=2"],
    ["~experiment", "+estimator=[ls]", "runner=slurm", "runner.n_jobs=2"],
    ["+noise@filter.other=ae_flip", "filter.other.sigma_deg=3"],
]
REFUSED = [
    ["a=1"],
    ["filter={ekf_vmf: {engine: numpy}}"],
    ["+reps=3"],
    ["+noise._target_=3"],
    ["~nope"],
    ["~seed=5"],
    ["seed.x=1", "seed.x.y=2"],
    ["x@y=1"],
    ["noise@x=vmf"],
    ["filter=[ukf_ae_adaptive]", "+filter.ukf_ae_adaptive.measurement.noise._target_=x"],
    ["noise=nope"],
    ["~noise=nope"],
    ["++noise=vmf"],
    ["+noise=vmf"],
    ["scenario.anchors=[1]"],
    ["scenario.anchors.position_m.x=1"],
    ["noise.sigma_deg=1,2"],
]
WITH_OWN = [
    ["experiment=mine"],
    ["experiment=mine", "filter.mine.measurement.kappa=3", "noise.sigma_deg=4", "reps=9"],
    ["experiment=mine", "~filter.mine", "seed=2"],
    ["noise=mine", "noise.kappa=3"],
    ["filter=[mine]", "~filter.mine.measurement.kappa"],
]


def strict(node):
    """Nested nodes in which equal numbers of different types differ and the order of keys does
    not.
    """
    if isinstance(node, dict):
        return {key: strict(value) for key, value in node.items()}
    return [strict(item) for item in node] if isinstance(node, list) else (type(node), node)


def by_hydra(lines):
    """Nodes and choices of Hydra's own composition."""
    cfg = hydra.compose("config", overrides=list(lines), return_hydra_config=True)
    choices = dict(cfg.hydra.runtime.choices)
    with open_dict(cfg):
        del cfg["hydra"]
    return OmegaConf.to_container(cfg, resolve=False), choices


def lines_of(words):
    return [setting.line for setting in read(words)]


@pytest.fixture(scope="module")
def composer():
    """One for all jobs, as in a sweep; Hydra is initialised."""
    with hydra_initialised():
        yield Composer()


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    folder = tmp_path_factory.mktemp("conf")
    for name, text in OWN.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    return str(folder)


@pytest.mark.parametrize("words", JOBS, ids=" ".join)
def test_a_job_equals_hydras_composition(words, composer):
    lines = lines_of(words)
    nodes, choices = by_hydra(lines)
    for _ in range(2):
        found = composer.composed(lines)
        assert strict(found.nodes) == strict(nodes)
        assert found.choices == choices


def test_jobs_leave_what_they_share_as_it_is(composer):
    before = copy.deepcopy({key: base.nodes for key, base in composer.bases.items()})
    for words in JOBS[:12]:
        composer.composed(lines_of(words))
    assert {key: composer.bases[key].nodes for key in before} == before
    for base in composer.bases.values():
        assert OmegaConf.to_container(base.cfg, resolve=False) == base.nodes


@pytest.mark.parametrize("words", REFUSED, ids=" ".join)
def test_a_job_is_refused_as_by_hydra(words, composer):
    lines = lines_of(words)
    with pytest.raises(Exception) as hydras:  # noqa: PT011 - any, and the same below
        by_hydra(lines)
    try:
        ours = list(composer.composed(lines).problems)
    except NotComposed as error:
        ours = list(error.errors.values())
    assert len(ours) == (2 if words[0] == "seed.x=1" else 1), "Hydra stops at the first"
    assert type(ours[0]) is type(hydras.value)
    assert str(ours[0]) == str(hydras.value)
    assert str(ours[0].__cause__) == str(hydras.value.__cause__)


def test_configs_of_ones_own(own):
    with hydra_initialised(own):
        composer = Composer()
        for words in WITH_OWN:
            found, expected = composer.composed(lines_of(words)), by_hydra(lines_of(words))
            assert strict(found.nodes) == strict(expected[0])
            assert found.choices == expected[1]
        assert composer.sweep(["experiment=mine"]) == {"noise.sigma_deg": "3,4"}
        assert composer.sweep(["experiment=open", "reps=5"]) == {"seed": "1,5"}


def test_hydra_composes_a_sweep_over_values_once(composer, monkeypatch):
    calls, real = [], hydra.compose
    monkeypatch.setattr(hydra, "compose", lambda *a, **k: calls.append(a) or real(*a, **k))
    cells = compose_cells(
        [EKF, "filter.ekf_vmf.measurement.kappa=3,4", "noise=vmf,ae_flip", "seed=range(0,5)"]
    )
    assert len(cells) == 20
    assert len(calls) == 3, "the experiment's own sweep, and each noise"
    assert [cell.changed for cell in cells[::10]] == [
        {"filter.ekf_vmf.measurement.kappa": kappa} for kappa in (3, 4)
    ]
    assert len({id(cell.scenario) for cell in cells}) == 1
    assert len({id(cell.noise) for cell in cells}) == 2
    assert len({id(cell.estimators["ekf_vmf"]) for cell in cells}) == 2


PLUG_IN = """from dataclasses import dataclass
from aoabench.noise.angular import VonMisesFisher

@dataclass(frozen=True)
class Mine(VonMisesFisher):
    pass
"""


def test_cells_share_no_object_of_a_class_of_ones_own(tmp_path, monkeypatch):
    """Its objects may keep what they have seen."""
    (tmp_path / "my_noise.py").write_text(PLUG_IN)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "conf" / "noise").mkdir(parents=True)
    (tmp_path / "conf" / "noise" / "mine.yaml").write_text("_target_: my_noise.Mine\n")
    words = [EKF, "noise=mine", "scenario.motion.q_z=0.2", "seed=1,2"]
    cells = compose_cells(words, config_dir=str(tmp_path / "conf"), plugins=["my_noise"])
    assert len({id(cell.noise) for cell in cells}) == 2
    assert len({id(cell.scenario) for cell in cells}) == 1


def test_positions_are_looked_at_once_unless_they_depend_on_the_seed(monkeypatch):
    looked, real = [], build.share_heard
    monkeypatch.setattr(
        build, "share_heard", lambda scenario, seed: looked.append(seed) or real(scenario, seed)
    )
    walls = ["scenario=indoor_map", "noise=ae_normal", "filter=[ekf_aoa]"]
    compose_cells([*walls, "seed=range(0,5)", "noise.sigma_deg=2,3"])
    assert looked == [0]
    looked.clear()
    builder, scattered = build.Builder(), Deaf("own", 4, spread_m=1)
    for seed in (1, 2, 1, 2):
        builder._heard(scattered, seed)
    assert looked == [1, 2]


def test_what_differs_from_the_presets_whoever_sets_it(tmp_path):
    """An experiment, or a file of one's own that sets keys at the top."""
    words = ["experiment=nurminen2018_particles", "filter=[pf_vmf,pf_ae_nominal]", "noise=vmf"]
    cell = compose_cells(words)[0]
    assert cell.changed["filter.pf_ae_nominal.particles"] == 100
    folder = tmp_path / "runner"
    folder.mkdir()
    (folder / "mine.yaml").write_text(
        "# @package _global_\nrunner: {out: o}\nfilter: {ekf_vmf: {engine: numpy}}\n"
    )
    (cell,) = compose_cells([EKF, "runner=mine"], config_dir=str(tmp_path))
    assert cell.changed == {"filter.ekf_vmf.engine": "numpy"}


def test_a_long_sweep_says_how_far_it_is_composed(monkeypatch):
    said = []
    monkeypatch.setattr(compose, "_SILENT_S", math.inf)
    compose_cells([EKF, "seed=1,2,3"], say=said.append)
    assert said == [], "not so long ago"
    monkeypatch.setattr(compose, "_SILENT_S", 0)
    compose_cells([EKF, "seed=1,2,3"], say=said.append)
    assert said == ["composing 3 cells: 0 done ..."]
    compose_cells([EKF, "seed=1,2,3"])


NODES = [
    {"a": 1, "b": "x"},
    {"a": {"x": "${b}"}, "b": [1, "${c.d}"], "c": {"d": None}, "e": 3},
    {"a": {"x": "${.y}", "y": "${..a.z}", "z": 2}, "b": "\\${a}"},
    {"a": "${${b}}", "b": "c", "c": 5},
    {"a": "${oc.select:b,3}", "b": "${oc.env:DASK_SCHEDULER_ADDRESS,null}"},
]


@pytest.mark.parametrize("raw", NODES, ids=str)
def test_nodes_are_resolved_as_by_omegaconf(raw):
    resolver = Resolver()
    for seed in (1, 2):
        assert resolver(raw | {"seed": seed}) == resolved(raw | {"seed": seed})


def test_a_sweep_beside_references_resolves_them_once():
    resolver = Resolver()
    for seed in range(3):
        resolver({"a": "${b}", "b": {"c": "${oc.env:DASK_SCHEDULER_ADDRESS,null}"}, "seed": seed})
    assert len(resolver.known) == 1
