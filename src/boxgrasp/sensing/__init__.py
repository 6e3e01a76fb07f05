"""One view of a depth camera, validated, and what is known of the sensor."""
