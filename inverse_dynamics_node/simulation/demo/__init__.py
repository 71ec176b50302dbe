"""The demo: the node and a simulated robot as processes, with scenarios and verdicts."""
