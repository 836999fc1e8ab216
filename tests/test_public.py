"""What `import aoabench` offers, and how it shows itself."""

import inspect

import aoabench


def test_dir_lists_the_public_names_alone():
    assert dir(aoabench) == sorted([*aoabench.__all__, "__version__"])


def test_every_public_function_explains_itself():
    """Each parameter, what is returned and what is raised."""
    for name in aoabench.__all__:
        one = getattr(aoabench, name)
        text = inspect.getdoc(one)
        assert text, name
        if inspect.isfunction(one):
            words = text.lower().replace("`", " ").replace(":", " ").replace(",", " ").split()
            lacking = [p for p in inspect.signature(one).parameters if p not in words]
            assert not lacking, (name, lacking)
