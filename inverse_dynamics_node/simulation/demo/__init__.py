"""The demo runs the node with a simulated robot in several scenarios, and judges each run."""
