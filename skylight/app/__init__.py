"""Each feature of the command line and the studio as typed functions over files."""
