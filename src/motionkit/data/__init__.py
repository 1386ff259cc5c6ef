"""A folder of BVH files in, a dataset of labelled clips out."""
