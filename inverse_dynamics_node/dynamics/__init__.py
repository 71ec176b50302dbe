"""Joint efforts by the recursion of Luh, Walker and Paul."""
