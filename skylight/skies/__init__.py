"""Where skies come from: simulated, captured, and what stands under them."""
