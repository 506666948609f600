"""Who answers a call: one file for each language a robot speaks."""
