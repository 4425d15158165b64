"""Speed of each part, compared with other programs that do the same work on the same machine.

``shmoo bench`` runs the benchmarks of `registry`. The folder also has the programs that make the pictures and measured
tables of docs/ (``python -m benchmarks.NAME`` in a clone). A wheel contains it as ``shmoo_mjx.benchmarks``.
"""
