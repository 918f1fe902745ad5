"""A floating manipulator that hits a floating box (Nekoo, Sharf & Ollero)."""
