"""A day in a lab: everything at once, with trouble, and every promise checked at its end.

    PYTHONPATH=clients/python/tests target/venv/bin/python -m day --minutes 5

`plan` draws the day from a seed; `node`, `scientists`, `controllers` and `viewers` live it, each
with a life of its own; `troubles` makes it hard; `chronicle` and `meter` look on; `evening` asks
once more; `promises` judges what was seen, and `report` tells.
"""
