"""Generates code for one robot; the other modules do not depend on this part."""
