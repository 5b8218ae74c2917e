# The Debian package: included by the Makefile.
.PHONY: deb

deb: setup  ## dist/hil_VERSION_ARCH.deb, with its Python packages inside
	@deploy/debian/build.sh
