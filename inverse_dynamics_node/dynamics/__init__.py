"""Computes joint efforts with the recursion of Luh, Walker and Paul."""
