"""Reference answers to single pushes, computed without the library under test."""
