"""The steps of ``tools/build_head.py``, from MakeHuman's assets to the head model's arrays."""
