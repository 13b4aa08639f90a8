"""What the command line does, as typed functions: estimate, write results, show, demonstrate."""
