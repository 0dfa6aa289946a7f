"""Drake LeafSystems, and beside each machine's systems the plain-function maths they wrap."""
