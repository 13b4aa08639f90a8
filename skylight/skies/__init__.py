"""Where skies come from: simulated days, and folders of captured ones."""
