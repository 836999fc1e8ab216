"""`python -m aoabench.cli`."""

from aoabench.cli.main import main

main()
