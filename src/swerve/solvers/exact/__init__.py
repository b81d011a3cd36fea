"""Exact solvers: answers without samples, from tables of states or all action sequences."""
