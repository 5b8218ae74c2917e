"""The pictures of docs/, drawn by `python -m docs.pictures`: one module a picture, the same bytes every time."""
