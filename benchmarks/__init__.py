"""How fast each part is, beside what else does the same work on the same machine: ``shmoo bench`` runs `registry`.

Beside the benchmarks lie the programs that make the pictures and measured tables of docs/, ``python -m
benchmarks.NAME`` in a clone. A wheel holds this folder as ``shmoo_mjx.benchmarks``.
"""
