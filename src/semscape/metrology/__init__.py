"""Numbers from height maps: levelling, filters, ISO 25178 parameters, profiles, steps, volumes, wear, uncertainty."""
