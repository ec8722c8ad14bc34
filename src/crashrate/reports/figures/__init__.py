"""The paper's figures for one run; plotly only, each in a module of its own."""
