"""Which pixels of a head show skin, and which hair or what lies on it."""
