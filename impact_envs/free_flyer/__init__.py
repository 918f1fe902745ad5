"""Free-flyers that move passive objects by impacts (Verhagen & Tumova)."""
