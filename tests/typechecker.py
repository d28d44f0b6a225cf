"""Check annotated types and shapes while the tests run, with the rules a static checker follows."""

from beartype import BeartypeConf, beartype

typechecker = beartype(conf=BeartypeConf(is_pep484_tower=True))  # an int is accepted where a float is
