"""Long work: resumable folders, processes, clusters, progress, devices."""
