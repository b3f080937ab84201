"""Gaussian splats: conversion from and to frames of a scene, and the files that other programs read."""
