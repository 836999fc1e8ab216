"""The reader of overrides: what it takes for a key, a file name, a sweep, and what it says."""

import pytest

from aoabench.config.compose import compose_cells, show
from aoabench.config.overrides import PATH_KEYS, file_setting, read
from aoabench.errors import UserError


def one(word, sweep=False):
    (setting,) = read([word], sweep)
    return setting


@pytest.mark.parametrize(("word", "key", "package", "value"), [
    ("noise.sigma_deg=3", "noise.sigma_deg", "", 3),
    ("+noise.sigma_deg=3", "noise.sigma_deg", "", 3),
    ("++noise@a.b=vmf", "noise", "a.b", "vmf"),
    ("noise.name='a b'", "noise.name", "", "a b"),
    ("filter=[a,b]", "filter", "", ["a", "b"]),
    ("'filter=[a,b]'", "filter", "", ["a", "b"]),  # as Windows' command prompt leaves it
    ('"noise=vmf"', "noise", "", "vmf"),
    ("x.y=null", "x.y", "", None),
    ("x.y=", "x.y", "", ""),
])  # fmt: skip
def test_parts_of_a_word(word, key, package, value):
    setting = one(word)
    assert (setting.key, setting.package, setting.value) == (key, package, value)
    assert not setting.is_sweep
    assert not setting.is_deletion


def test_deletions_and_sweeps():
    assert one("~noise").is_deletion
    assert one("~noise=vmf").is_deletion
    assert one("x.y=1,2", sweep=True).is_sweep
    assert one("x.y=range(1,5)").is_sweep
    assert not one("x.y=[1,2]").is_sweep


NAMES = [
    "my log (1), ä=b.csv",
    "it's.csv",
    'a "quoted" name.csv',
    "both ' and \".csv",
    "[1].csv",
    "{a}.csv",
    "a,b.csv",
    "=.csv",
    "~/log.csv",
    "2024",
    "1e5",
    "true",
    "nan",
    "C:\\data\\log (1).csv",
    "C:\\new\\table.csv",
    "D:/logs/a.csv",
    "\\\\server\\share\\log.csv",
    "ends with \\",
    "\\'",
    "choice(a).csv",
    "straße/日本 #&;!.csv",
    "a;b|c<d>e^f`g.csv",
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("key", PATH_KEYS)
def test_any_name_of_a_file_is_read_as_it_is(key, name):
    assert one(f"{key}={name}").value == name
    assert one(f"++{key}={name}").value == name


@pytest.mark.parametrize("name", NAMES)
def test_a_name_given_from_python_is_never_a_sweep(name):
    setting = one(file_setting("runner.out", name), sweep=True)
    assert setting.value == name
    assert not setting.is_sweep


@pytest.mark.parametrize(("value", "means"), [
    ("'my log, (1).csv'", "my log, (1).csv"),
    ('"my log, (1).csv"', "my log, (1).csv"),
    ("my\\ log.csv", "my log.csv"),
    ("plain/name-1.csv", "plain/name-1.csv"),
    ("null", None),
    ("", ""),
    ("[[0,0],[1,1]]", [[0, 0], [1, 1]]),
    ("{position_m: [[1,2,3]]}", {"position_m": [[1, 2, 3]]}),
    ("${oc.env:LOG}", "${oc.env:LOG}"),
    ("  spaces.csv ", "spaces.csv"),
    ("  spä ces.csv ", "spä ces.csv"),
])  # fmt: skip
def test_what_hydra_reads_already_means_what_it_did(value, means):
    assert one(f"scenario.anchors={value}").value == means


@pytest.mark.parametrize(("value", "means"), [
    ("a.csv,b.csv", ["a.csv", "b.csv"]),
    ("a (1).csv, ä=b.csv", ["a (1).csv", "ä=b.csv"]),
    ("1,2", ["1", "2"]),
    ("C:\\a.csv,\\\\server\\b.csv", ["C:\\a.csv", "\\\\server\\b.csv"]),
    ("\\\\server\\a.csv,\\\\server\\b.csv", ["\\\\server\\a.csv", "\\\\server\\b.csv"]),
    ("'x, y.csv',z (2).csv", ["x, y.csv", "z (2).csv"]),
    ("it's.csv,\"a, b.csv\" , c.csv", ["it's.csv", "a, b.csv", "c.csv"]),
    ("choice(a.csv,b.csv)", ["a.csv", "b.csv"]),
    ("null,a b.csv", [None, "a b.csv"]),
])  # fmt: skip
def test_under_a_sweep_commas_separate_files(value, means):
    setting = one(f"scenario.path={value}", sweep=True)
    found = [one(f"x={value}").value for value in setting.parsed.sweep_string_iterator()]
    assert found == means


def test_other_keys_are_not_quoted():
    with pytest.raises(UserError, match="'\\(' is not closed"):
        one("scenario.name=a (1")
    assert one("noise.sigma_deg=2,3", sweep=True).is_sweep


@pytest.mark.parametrize(("word", "says"), [
    ("filter=[a", "'[' is not closed"),
    ("filter=a]", "']' closes nothing"),
    ("filter=[a)", "')' closes nothing"),
    ("x={a:[1}", "'}' closes nothing"),
    ("x=it's", "the quote ' is not closed"),
    ('x="a', 'the quote " is not closed'),
    ("x=ä", "'ä' needs quotes"),
    ("x=a=b", "'=' needs quotes"),
    ("x=a b(", "'(' is not closed"),
    ("x=[1] 2", "the text is not a value"),
    ("x=rng(1,5)", "unknown function 'rng'"),
    ("nöise=3", "'nöise' is not a key"),
    ("a b=3", "'a b' is not a key"),
    ("=3", "'' is not a key"),
    ("x=" + "[" * 2000 + "]" * 2000, "nested too deeply"),
    ("x=" + "[" * 5000, "'[' is not closed"),
    ("noise", "not an override"),
    ("", "not an override"),
    ("noise:vmf", "did you mean 'noise=vmf'"),
    ("y" * 5000, "not an override"),
    ("y" * 5000 + "=(", "is not closed"),
    ("ö" * 5000 + "=3", "is not a key"),
])  # fmt: skip
def test_plain_words_and_no_names_of_classes(word, says):
    with pytest.raises(UserError) as error:
        one(word)
    text = str(error.value)
    assert says in text
    assert len(text) < 700
    assert word[:90] in text, "the word is named"
    for name in ("Exception", "Error", "Lexer", "viable", "mismatched", "token", "EOF"):
        assert name not in text


@pytest.mark.parametrize(("word", "advice"), [
    ("x=a(1) b", "'x=\"a(1) b\"'"), ("x=it's", "\"x=\\\"it's\\\"\""), ('x=a"b', "'x=\"VALUE\"'"),
])  # fmt: skip
def test_the_advice_on_quotes_can_be_pasted_into_a_shell(word, advice):
    import shlex

    with pytest.raises(UserError) as error:
        one(word)
    assert str(error.value).endswith(f"two pairs of quotes: {advice}")
    (typed,) = shlex.split(advice)
    assert one(typed).key == "x"


@pytest.mark.parametrize("word", [
    "+noise@_global_.hydra.callbacks.x=vmf", "noise@a.hydra.b=vmf", "a.hydra.b=1", "~hydra.job",
    "experiment=$\\{oc.env:X\\}", "experiment=a,$\\{oc.env:X\\}", "noise='..'", "noise=[..]", "noise=choice(a,'../b')",
])  # fmt: skip
def test_neither_hydra_nor_files_elsewhere_are_reached(word):
    with pytest.raises(UserError, match=r"nothing under hydra|the name of a preset is needed"):
        compose_cells(["filter=[ekf_vmf]", word])
    with pytest.raises(UserError, match=r"nothing under hydra|the name of a preset is needed"):
        show(["filter=[ekf_vmf]", word], sweep=True)


def test_plugins_are_one_list():
    for value in ("a,b", "a", "3"):
        with pytest.raises(UserError, match=r"a list of importable packages: plugins=\["):
            compose_cells(["filter=[ekf_vmf]", f"plugins={value}"])
    assert compose_cells(["filter=[ekf_vmf]", "plugins=null"])[0].plugins == ()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("filter=[ekf_vmf] +filter=[ukf_vmf]", "filter=[ekf_vmf] and +filter=[ukf_vmf]: filter is set "
         "in two ways; allowed: one list, filter=[ekf_vmf,ukf_vmf]"),
        ("+estimator=ls_lines estimator=[wcg,ls_lines]", "+estimator=ls_lines and "
         "estimator=[wcg,ls_lines]: estimator is set in two ways; allowed: one list, "
         "estimator=[ls_lines,wcg]"),
        ("+filter=[ekf_vmf] +filter=ukf_vmf", "+filter=[ekf_vmf] and +filter=ukf_vmf: filter is set in "
         "two ways; allowed: one list, filter=[ekf_vmf,ukf_vmf]"),
        ("noise=vmf +noise=ae_flip", "noise=vmf and +noise=ae_flip: noise is set in two ways; "
         "allowed: one of them"),
        ("reps=2 ++reps=3", "reps=2 and ++reps=3: reps is set in two ways; allowed: one of them"),
    ],
)  # fmt: skip
def test_a_key_is_not_set_in_two_ways(words, message):
    with pytest.raises(UserError) as error:
        compose_cells(words.split())
    assert str(error.value) == message


def test_what_is_added_is_there():
    """To the estimators of an experiment; a key that is set twice has its last value."""
    words = ["experiment=le2021_fig6", "noise.sigma_deg=2", "+estimator=[vmf_ml]"]
    cell = compose_cells(words)[0]
    assert {"vmf_ml", "ls", "ml_kcorr"} <= set(cell.estimators)
    (cell,) = compose_cells(["filter=[ekf_vmf]", "filter=[ukf_vmf]"])
    assert list(cell.estimators) == ["ukf_vmf"]


def test_a_deleted_key_in_a_sweep():
    """The way of `aoabench.run`: every run is a sweep."""
    cells = compose_cells(["filter=[ekf_vmf]", "~until", "+until={metric: null}", "seed=1,2"])
    assert [cell.seed for cell in cells] == [1, 2]
    assert "until" not in "".join(cells[0].swept)


@pytest.mark.parametrize(("word", "says"), [
    ("noise.sigma_deg=range(1,5,0)", "the step of a range must not be 0"),
    ("noise.sigma_deg=range(1.0,5,0)", "the step of a range must not be 0"),
    ("noise.sigma_deg=interval(1,5)", "not single values"),
    ("noise.sigma_deg=range(0,1,1e-9)", "more than 100000 values"),
    ("+noise=vmf", r"one noise is chosen already; allowed: noise=vmf"),
    ("noise=null", "the name of a preset must be a string"),
    ("noise.sigma_deg=${nope}", "Interpolation key 'nope' not found"),
    ("noise.sigma_deg='${x'", r"an interpolation \$\{...\} in the value cannot be read"),
    ("noise.sigma_deg=" + "x" * 5000, "x ... x"),
    ("noise=" + "x" * 5000, "x ... x"),
    ("scenario.anchors=[1]", "Cannot merge a mapping with a list"),
    ("x" * 5000 + "=3", "x ... x"),
    ("noise." + "x" * 5000 + "=3", "x ... x"),
])  # fmt: skip
def test_what_cannot_be_composed_names_the_word_alone(word, says):
    with pytest.raises(UserError, match=says) as error:
        compose_cells(["filter=[ekf_vmf]", word, "reps=2"])
    text = str(error.value)
    assert "reps" not in text
    assert "ekf_vmf" not in text
    assert len(text) < 900
    assert "Exception" not in text
    assert "Config" not in text
    assert "Errno" not in text
