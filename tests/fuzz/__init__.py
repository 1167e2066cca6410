"""Files that strangers might write: good ones, mutated by chance, and what coopqp makes of them.

``python -m tests.fuzz --cases 20000 --seed 0`` runs them in processes of their own and lists every
case that ends in anything but a scenario that runs, or a refusal in words with its line.
"""
