"""What every part uses: array types, segments, errors, settings, YAML files and wording."""
