"""``python -m jaxscp``."""

from jaxscp.cli.start import main

if __name__ == "__main__":
    main()
