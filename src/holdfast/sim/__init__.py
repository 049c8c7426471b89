"""A machine on a site whose truth is known: motion, sensors and their faults, written as an ordinary recording."""
