"""Parts of contact_system.plan: starts of contacts, their motion, its explanation, saved plans."""
