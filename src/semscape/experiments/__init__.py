"""The experiments of the thesis and of the method, each one command with one seed: tables, figures, a page."""
