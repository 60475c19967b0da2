"""From the camera driver to the planner: conversion, rectification, camera matrix, and buffers of images and poses."""
