"""What `import modelgap as mg` gives: the core's results, to be shown and kept.

Everything here takes recordings and robots and returns a result of the core with
methods on top of it: pages, JSON, tables. `modelgap.py` loads each name on first use.
"""
