"""Laws of impact and contact that every domain shares; no scenario, no environment."""
