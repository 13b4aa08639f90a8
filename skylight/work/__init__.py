"""Long computations: resumable folders, processes, clusters, devices, progress."""
