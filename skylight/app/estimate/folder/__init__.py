"""Folders of photographs: resumable, one by one or solved together."""
