"""Light probes merged from photographs of mirror balls."""
